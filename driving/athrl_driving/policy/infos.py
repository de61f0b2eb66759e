"""Infos of several vectors of environments as those of one, in gymnasium's format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def common_infos(
    infos: Sequence[Mapping[str, Any]], env_indices: Sequence[NDArray[np.int64]], count: int
) -> dict[str, Any]:
    """Merge the infos of vectors, each at its `env_indices`, int64 [n], of `count`; missing values are 0."""
    together: dict[str, Any] = {}
    for key in dict.fromkeys(key for part in infos for key in part):
        # Metrics come only from the few vectors in which an episode has ended.
        known = [(part[key], places) for part, places in zip(infos, env_indices, strict=True) if key in part]
        values = [value for value, _ in known]
        if isinstance(values[0], dict):
            together[key] = common_infos(values, [places for _, places in known], count)
            continue
        together[key] = np.zeros((count, *values[0].shape[1:]), values[0].dtype)
        for value, places in known:
            together[key][places] = value
    return together
