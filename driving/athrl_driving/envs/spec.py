"""The specs that gymnasium gives environments, in a form that `spec.to_json()` can write."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec


class PlainSpec:
    """Mixin of an environment whose spec keeps plain values of its arguments: a path as text, for example."""

    @property
    def spec(self) -> EnvSpec | None:
        """How the environment was made, None if gymnasium did not make it."""
        return self.__dict__.get("spec")

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec = copy.copy(spec)
            spec.kwargs = _plain(spec.kwargs)
        self.__dict__["spec"] = spec


def _plain(value: Any) -> Any:
    """Return paths as text, NumPy's numbers as Python's, members of an enum as their values."""
    if isinstance(value, Mapping):
        return {name: _plain(each) for name, each in value.items()}
    if type(value) in (tuple, list):
        return type(value)(map(_plain, value))
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, np.generic):
        return value.item()
    return value.value if isinstance(value, Enum) else value
