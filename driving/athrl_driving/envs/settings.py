"""The settings of an environment and their checks: a misspelt or impossible one does not go unnoticed."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from typing import Any

from ..episode import DriveSettings, Episodes
from ..maps import Town, load_town

DEFAULTS: dict[str, Any] = {
    "observation": {"type": "BirdEyeObservation"},
    "action": {"type": "WaypointAction"},
    "town": "town03",  # name of a town, or path of an OpenDRIVE file
    "vehicles_count": 100,  # background vehicles
    "image_size": 32,  # [px] height and width of the observation's image
    "episode_ticks": 500,
    "ticks_per_decision": 4,
    "simulation_frequency": 10,  # [Hz]
    "maximum_speed": 7.95,  # [m/s] highest target speed; above 8 m/s every tick costs
    "waypoint_radius": 8.0,  # [m]
    "waypoint_half_angle": math.pi / 6,  # [rad]
    "screen_width": 600,  # [px]
    "screen_height": 600,  # [px]
    "centering_position": [0.5, 0.5],
    "scaling": 6.0,
}
"""What an environment adds to highway-env's own settings, or has other defaults for."""

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


def changed_settings(
    present: Mapping[str, Any], changes: Mapping[str, Any] | None, map_name: str | None
) -> dict[str, Any]:
    """The present settings with `changes`; `map_name` is the map that the environment was made for, if any.

    Raises ValueError, in one line, for a key that does not exist or a value that cannot be.
    """
    given = dict(changes or {})
    if map_name is not None and given.setdefault("town", map_name) != map_name:
        raise ValueError(f"the environment is of {map_name}, but its setting town is {given['town']!r}")
    for key in given:
        if key not in present:
            near = difflib.get_close_matches(key, present, n=1)
            hint = f", did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"the environment has no setting {key!r}{hint}")
    settings = {**present, **given}
    _check(settings)
    # highway-env's word for decisions per second; it is no setting, but follows from two that are.
    settings["policy_frequency"] = settings["simulation_frequency"] / settings["ticks_per_decision"]
    return settings


def _check(settings: Mapping[str, Any]) -> None:
    for key, (kind, low, high) in _BOUNDS.items():
        value = settings[key]
        accepted = (int,) if kind is int else (int, float)
        if isinstance(value, bool) or not isinstance(value, accepted) or not low <= value <= high:
            noun = "a whole number" if kind is int else "a number"
            raise ValueError(f"the setting {key} is {value!r}, it should be {noun} from {low:g} to {high:g}")
    for key, expected in (("observation", "BirdEyeObservation"), ("action", "WaypointAction")):
        if settings[key] != {"type": expected}:
            raise ValueError(f"the setting {key} is {settings[key]!r}, it should be {{'type': {expected!r}}}")


def town_of(config: Mapping[str, Any]) -> Town:
    """The town that settings name; raises ValueError in one line where there is none or it cannot be read."""
    return load_town(config["town"])


def drive_settings(config: Mapping[str, Any]) -> DriveSettings:
    """What the kernel takes from an environment's settings."""
    return DriveSettings(
        interval=1.0 / config["simulation_frequency"],
        ticks_per_decision=int(config["ticks_per_decision"]),
        episode_ticks=int(config["episode_ticks"]),
        maximum_speed=float(config["maximum_speed"]),
        waypoint_radius=float(config["waypoint_radius"]),
        waypoint_half_angle=float(config["waypoint_half_angle"]),
    )


def new_episodes(config: Mapping[str, Any], town: Town, environments: int, threads: int = 1) -> Episodes:
    """Room for the episodes of `environments` environments with these settings."""
    return Episodes(
        town,
        drive_settings(config),
        environments,
        vehicles=int(config["vehicles_count"]),
        image_size=int(config["image_size"]),
        threads=threads,
    )
