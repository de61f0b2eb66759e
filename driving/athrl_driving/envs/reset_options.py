"""The options of `reset` and their checks: one that does not exist is an error."""

from __future__ import annotations

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
