"""Checks of an environment's settings, so that a misspelt or impossible one does not go unnoticed."""

from __future__ import annotations

import difflib
import math
from typing import Any

_BOUNDS: dict[str, tuple[type, float, float]] = {
    "vehicles_count": (int, 0, 10_000),
    "image_size": (int, 8, 512),
    "episode_ticks": (int, 1, 10**9),
    "ticks_per_decision": (int, 1, 1000),
    "simulation_frequency": (float, 1, 1000),
    "maximum_speed": (float, 0.1, 40),
    "waypoint_radius": (float, 1, 100),
    "waypoint_half_angle": (float, 0.01, math.pi / 2),
}


def check_settings(settings: dict[str, Any], defaults: dict[str, Any]) -> None:
    """Raise ValueError, in one line, for a key that does not exist or a value that cannot be."""
    for key in settings:
        if key not in defaults:
            near = difflib.get_close_matches(key, defaults, n=1)
            hint = f", did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"the environment has no setting {key!r}{hint}")
    for key, (kind, low, high) in _BOUNDS.items():
        value = settings[key]
        accepted = (int,) if kind is int else (int, float)
        if isinstance(value, bool) or not isinstance(value, accepted) or not low <= value <= high:
            noun = "a whole number" if kind is int else "a number"
            raise ValueError(f"the setting {key} is {value!r}, it should be {noun} from {low:g} to {high:g}")
    for key, expected in (("observation", "BirdEyeObservation"), ("action", "WaypointAction")):
        if settings[key] != {"type": expected}:
            raise ValueError(f"the setting {key} is {settings[key]!r}, it should be {{'type': {expected!r}}}")
