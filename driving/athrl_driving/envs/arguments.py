"""The arguments with which environments are made, and their checks: a misspelt one is an error."""

from __future__ import annotations

import difflib
import inspect
import os
from collections.abc import Callable, Collection, Mapping
from typing import Any

from athrl_spaces import RANDOM_TOWNS, TOWNS

from athrl_driving.errors import DrivingError

TOWN_MAY_BE = f"one of {', '.join(TOWNS)}, {RANDOM_TOWNS}, or the path of an OpenDRIVE file (.xodr)"
"""What an error says of where a town has to be named."""


def refuse_arguments(
    arguments: Mapping[str, Any], constructor: Callable[..., None], settings: Collection[str]
) -> None:
    """Raise TypeError, in one line, if an environment was made with arguments that its constructor has not.

    It suggests the nearest argument, or the nearest of the `settings`, which are given in another way.
    """
    if not arguments:
        return
    name, value = next(iter(arguments.items()))
    known = [each for each in inspect.signature(constructor).parameters if each not in ("self", "others")]
    near = difflib.get_close_matches(name, [*known, *settings], n=1)
    if name in settings:
        hint = f"; a setting is given as config={{{name!r}: {value!r}}}"
    elif not near:
        hint = f", there are {', '.join(known)}"
    elif near[0] in known:
        hint = f", did you mean {near[0]!r}?"
    else:
        hint = f", did you mean the setting config={{{near[0]!r}: {value!r}}}?"
    raise TypeError(f"an environment has no argument {name!r}{hint}")


def map_argument(town: Any, config: Any = None) -> str | None:
    """The argument `map` as text; where it is empty, the map that the settings `config` name, if they do.

    Raises DrivingError, in one line, for what is no name and no path.
    """
    if town == "" and isinstance(config, Mapping):
        return as_text(config.get("town", ""))
    if town is not None and not isinstance(town, (str, os.PathLike)):
        raise DrivingError(f"map is {town!r}, it should be {TOWN_MAY_BE}")
    return as_text(town)


def as_text(path: Any) -> Any:
    """A path as text, and everything else as it is."""
    return os.fspath(path) if isinstance(path, os.PathLike) else path
