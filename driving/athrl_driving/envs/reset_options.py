"""What a reset follows: options, of which an unknown one is an error, and what was written to `config`."""

from __future__ import annotations

import copy
import difflib
from collections.abc import Mapping
from typing import Any

from athrl_driving.errors import DrivingError

CONFIG = "config"
"""Settings to change before the new episode, as in highway-env."""
RESET_MASK = "reset_mask"
"""The environments of a vector to reset, as in gymnasium."""


def checked_options(options: Mapping[str, Any] | None, known: tuple[str, ...]) -> Mapping[str, Any]:
    """Return the options of a reset; raises DrivingError, in one line, for one that is not `known`."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise DrivingError(f"the options of reset are {options!r}, they should be a dict")
    for name in options:
        if name not in known:
            near = difflib.get_close_matches(str(name), known, n=1)
            hint = f", did you mean {near[0]!r}?" if near else f", there is {' and '.join(map(repr, known))}"
            raise DrivingError(f"reset has no option {name!r}{hint}")
    return options


def written_settings(config: Mapping[str, Any], adopted: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that somebody has written to an environment's `config` since it `adopted` these.

    That is how highway-env's environments are configured. What was removed is as it was adopted.
    """
    written = {
        name: value for name, value in config.items() if name not in adopted or _differ(value, adopted[name])
    }
    return {**written, **{name: copy.deepcopy(adopted[name]) for name in adopted.keys() - config.keys()}}


def with_written(
    changes: Mapping[str, Any] | None, config: Mapping[str, Any], adopted: Mapping[str, Any]
) -> Mapping[str, Any] | None:
    """Return changes of settings with those that were written to `config`; what is no dict is as it is."""
    written = written_settings(config, adopted)
    if not written or not isinstance(changes, Mapping | None):
        return changes
    return {**written, **(changes or {})}


def _differ(value: Any, other: Any) -> bool:
    try:
        return bool(value != other)
    except ValueError:  # arrays, which no setting is
        return True
