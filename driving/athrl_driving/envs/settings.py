"""The settings of an environment and their checks: a misspelt or invalid one is an error."""

from __future__ import annotations

import copy
import difflib
import math
import numbers
from collections.abc import Mapping
from typing import Any

from athrl_spaces import DIRECT, WAYPOINT, WAYPOINT_SET, Limits, action_kind
from athrl_spaces.environment import BOUNDS

from athrl_driving.envs.arguments import TOWN_MAY_BE, as_text
from athrl_driving.episode import DriveSettings, Episodes, ObservationArrays, Workers, new_observation_arrays
from athrl_driving.episode.decision import KIND_NUMBERS
from athrl_driving.episode.starts import RANDOM, Journeys, place_on_map
from athrl_driving.errors import DrivingError
from athrl_driving.maps import Town, load_town
from athrl_driving.perception import EGO_ABOVE_LOWER_EDGE, LIDAR_RANGE, RAYS, WINDOW_SIDE, new_perception
from athrl_driving.scenarios import SCENARIOS, places_near
from athrl_driving.traffic.state import new_traffic

ACTION_KIND_OF_TYPE = {
    "WaypointAction": WAYPOINT,
    "WaypointSetAction": WAYPOINT_SET,
    "DirectAction": DIRECT,
}
"""The kind of action (`athrl_spaces.ACTION_KINDS`) by its name in the setting `action`."""

_LIMITS = Limits()

DEFAULTS: dict[str, Any] = {
    "observation": {"type": "BirdEyeObservation"},
    "action": {"type": "WaypointAction"},
    "town": "town03",  # name of a town, or path of an OpenDRIVE file
    "strict_map": False,  # refuse what OpenDRIVE forbids, also where it could be bridged
    "start": None,  # (road name, lane id, [m] along it); a random place without one
    "destination": None,  # such a place, "random", or random turns without one
    "vehicles_count": 100,  # background vehicles
    "traffic_near": None,  # (x, y, radius) [m] where they start; anywhere without it
    "image_size": 32,  # [px] height and width of the observation's image
    "window_side": WINDOW_SIDE,  # [m] of the square that the image shows
    "ego_above_lower_edge": EGO_ABOVE_LOWER_EDGE,  # [m] where the ego is in it
    "lidar_range": LIDAR_RANGE,  # [m]
    "lidar_rays": RAYS,
    "episode_ticks": 500,
    "ticks_per_decision": 4,
    "simulation_frequency": 10,  # [Hz]
    "maximum_speed": _LIMITS.maximum_speed,  # [m/s] highest target speed; above 8 m/s every tick costs
    "waypoint_radius": _LIMITS.waypoint_radius,  # [m]
    "waypoint_half_angle": _LIMITS.waypoint_half_angle,  # [rad]
    "speed_gain": _LIMITS.speed_gain,  # [1/s] acceleration for each m/s that is missing to the target speed
    "screen_width": 600,  # [px]
    "screen_height": 600,  # [px]
    "centering_position": [0.5, 0.5],
    "scaling": 6.0,
}
"""Settings that are added to highway-env's own, or have other defaults."""

_OF_THE_TOWN = ("town", "strict_map")
_PERCEPTION_SETTINGS = ("window_side", "ego_above_lower_edge", "lidar_range", "lidar_rays")

_BOUNDS: dict[str, tuple[type, float, float]] = {
    "vehicles_count": BOUNDS["vehicles"],
    "window_side": (float, 4, 1000),
    "ego_above_lower_edge": (float, 0, 1000),
    "lidar_range": (float, 0.01, 1000),
    "lidar_rays": (int, 4, 7200),
    "screen_width": (int, 16, 10_000),
    "screen_height": (int, 16, 10_000),
    "scaling": (float, 0.1, 1000),
    "simulation_frequency": (float, 1, 1000),
    **{
        name: BOUNDS[name]
        for name in (
            "image_size",
            "episode_ticks",
            "ticks_per_decision",
            "maximum_speed",
            "waypoint_radius",
            "speed_gain",
        )
    },
    "waypoint_half_angle": (
        float,
        math.radians(BOUNDS["waypoint_half_angle"][1]),
        math.radians(BOUNDS["waypoint_half_angle"][2]),
    ),
}

_SWITCHES: dict[str, tuple[bool | None, ...]] = {
    "strict_map": (False, True),
    "show_trajectories": (False, True),
    "render_agent": (False, True),
    "real_time_rendering": (False, True),
    "offscreen_rendering": (None, False, True),
}

_WITHOUT_EFFECT = {
    "other_vehicles_type": "a town has vehicles of its own kind",
    "neighbour_vehicles_connected_lanes": "a town's vehicles see across all lanes that are connected",
    "manual_control": "there are no keys for the actions of a town",
}
"""highway-env's settings that have no effect in a town, and why; they cannot be changed."""


def first_settings(defaults: Mapping[str, Any], scenario: str | None) -> dict[str, Any]:
    """The defaults of an environment, or of the case study with the id `scenario`.

    Raises ValueError in one line for a case study that does not exist.
    """
    if scenario is None:
        return dict(defaults)
    if scenario not in SCENARIOS:
        raise DrivingError(f"there is no case study {scenario!r}, there are {', '.join(SCENARIOS)}")
    return {**defaults, **SCENARIOS[scenario]}


def changed_settings(
    present: Mapping[str, Any], changes: Mapping[str, Any] | None, map_name: str | None
) -> dict[str, Any]:
    """The present settings with `changes`; `map_name` is the map that the environment was made for, if any.

    Raises ValueError, in one line, for a key that does not exist or an invalid value.
    """
    if changes is not None and not isinstance(changes, Mapping):
        raise DrivingError(f"config is {changes!r}, it should be a dict of settings")
    given = copy.deepcopy(dict(changes or {}))  # what the caller changes later is not ours
    if "town" in given:
        given["town"] = as_text(given["town"])
    if map_name == "":
        raise DrivingError("no map was named: give map='PATH.xodr', an OpenDRIVE file, or the name of a town")
    if map_name is not None and given.setdefault("town", map_name) != map_name:
        raise DrivingError(f"the environment is of {map_name}, but its setting town is {given['town']!r}")
    for key, value in given.items():
        if key not in present:
            near = difflib.get_close_matches(str(key), present, n=1)
            hint = f", did you mean {near[0]!r}?" if near else ""
            raise DrivingError(f"the environment has no setting {key!r}{hint}")
        if key in _WITHOUT_EFFECT and value != present[key]:
            raise DrivingError(
                f"the setting {key} is {value!r}, it should stay {present[key]!r}: {_WITHOUT_EFFECT[key]}"
            )
    settings = {**present, **given}
    _check(settings)
    # highway-env's name for decisions per second; it is no setting but follows from two settings.
    settings["policy_frequency"] = settings["simulation_frequency"] / settings["ticks_per_decision"]
    _check_policy_frequency(given, settings)
    return settings


def _check_policy_frequency(given: Mapping[str, Any], settings: Mapping[str, Any]) -> None:
    """Refuse another frequency; settings that were read from an environment contain the right one."""
    value, follows = given.get("policy_frequency"), settings["policy_frequency"]
    if value is not None and value != follows:
        raise DrivingError(
            f"the setting policy_frequency is {value!r}, it should be {follows:g}: "
            f"simulation_frequency / ticks_per_decision, which are the settings to change"
        )


def _check(settings: Mapping[str, Any]) -> None:
    for key, bounds in _BOUNDS.items():
        _check_number(key, settings[key], *bounds)
    for key, values in _SWITCHES.items():
        if not any(settings[key] is value for value in values):
            choice = ", ".join(map(str, values[:-1])) + f" or {values[-1]}"
            raise DrivingError(f"the setting {key} is {settings[key]!r}, it should be {choice}")
    _check_places(settings)
    centre = settings["centering_position"]
    if not (_are_numbers(centre) and len(centre) == 2 and all(0 <= value <= 1 for value in centre)):
        raise DrivingError(
            f"the setting centering_position is {centre!r}, it should be two numbers from 0 to 1"
        )
    if settings["observation"] != {"type": "BirdEyeObservation"}:
        raise DrivingError(
            f"the setting observation is {settings['observation']!r}, "
            "it should be {'type': 'BirdEyeObservation'}"
        )
    _check_action(settings["action"])


def _check_action(action: Any) -> None:
    """Refuse an unknown type of action and suggest the nearest one."""
    name = action.get("type") if isinstance(action, Mapping) else action
    if isinstance(name, str) and name in ACTION_KIND_OF_TYPE and action == {"type": name}:
        return
    near = difflib.get_close_matches(str(name), ACTION_KIND_OF_TYPE, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise DrivingError(
        f"the setting action is {action!r}, it should be {{'type': 'WaypointAction'}}, or with another of "
        f"{', '.join(ACTION_KIND_OF_TYPE)}{hint}"
    )


def _check_number(key: str, value: Any, kind: type, low: float, high: float) -> None:
    accepted = numbers.Integral if kind is int else numbers.Real
    is_number = isinstance(value, accepted) and not isinstance(value, bool)
    if not is_number or not low <= value <= high:
        noun = "a whole number" if kind is int else "a number"
        raise DrivingError(f"the setting {key} is {value!r}, it should be {noun} from {low:g} to {high:g}")


def _check_places(settings: Mapping[str, Any]) -> None:
    """Check the map and the places on it, as far as possible without reading the map."""
    if not isinstance(settings["town"], str):
        raise DrivingError(f"the setting town is {settings['town']!r}, it should be {TOWN_MAY_BE}")
    for key in ("start", "destination"):
        if settings[key] is not None and not _is_place(settings[key], key == "destination"):
            choice = ', "random"' if key == "destination" else ""
            raise DrivingError(
                f"the setting {key} is {settings[key]!r}, "
                f"it should be None{choice} or (road name, lane id, metres along it)"
            )
    near = settings["traffic_near"]
    if near is not None and not (_are_numbers(near) and len(near) == 3 and near[2] > 0):
        raise DrivingError(
            f"the setting traffic_near is {near!r}, it should be None or (x, y, radius) in metres"
        )


def _is_place(value: Any, may_be_random: bool) -> bool:
    if isinstance(value, str):
        return may_be_random and value == RANDOM
    return (
        isinstance(value, (tuple, list))
        and len(value) == 3
        and isinstance(value[0], str)
        and isinstance(value[1], numbers.Integral)
        and _are_numbers(value[1:])
    )


def _are_numbers(values: Any) -> bool:
    return isinstance(values, (tuple, list)) and all(
        isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)
        for value in values
    )


def action_setting(kind: str) -> dict[str, str]:
    """The setting `action` for a kind of action; raises ValueError in one line for an unknown one."""
    action_kind(kind)
    return {"type": next(name for name, known in ACTION_KIND_OF_TYPE.items() if known == kind)}


def town_of(config: Mapping[str, Any], present_config: Mapping[str, Any], present_town: Town | None) -> Town:
    """The town that settings name: the present one, if there is one and the present settings name the same.

    So an environment that has come from a process with another working directory keeps its town. Raises
    ValueError in one line if a town does not exist or cannot be read.
    """
    if present_town is not None and all(config[name] == present_config[name] for name in _OF_THE_TOWN):
        return present_town
    return load_town(config["town"], strict=config["strict_map"])


def drive_settings(config: Mapping[str, Any]) -> DriveSettings:
    """The kernel's settings from an environment's settings."""
    return DriveSettings(
        interval=1.0 / config["simulation_frequency"],
        ticks_per_decision=int(config["ticks_per_decision"]),
        episode_ticks=int(config["episode_ticks"]),
        maximum_speed=float(config["maximum_speed"]),
        waypoint_radius=float(config["waypoint_radius"]),
        waypoint_half_angle=float(config["waypoint_half_angle"]),
        speed_gain=float(config["speed_gain"]),
        action_kind=KIND_NUMBERS[ACTION_KIND_OF_TYPE[config["action"]["type"]]],
    )


def new_episodes(
    config: Mapping[str, Any],
    town: Town,
    environments: int,
    workers: Workers | None = None,
    observations: ObservationArrays | None = None,
) -> Episodes:
    """Allocate the episodes of `environments` environments with these settings.

    The workers drive them, or without workers the caller's thread. They write their observations to
    `observations`, which names as many environments; without it they have arrays of their own.

    Raises ValueError in one line for a place that is not on the map, or where the vehicles do not fit.
    """
    _check_room_near(config, town)
    drive, destination = drive_settings(config), config["destination"]
    return Episodes(
        town,
        drive,
        new_perception(town, **{name: config[name] for name in _PERCEPTION_SETTINGS}),
        observations or new_observation_arrays(environments, int(config["image_size"]), 0),
        Journeys(
            town,
            drive.episode_ticks * drive.interval,
            None if config["start"] is None else place_on_map(town, config["start"]),
            destination if destination in (None, RANDOM) else place_on_map(town, destination),
        ),
        vehicles=int(config["vehicles_count"]),
        traffic_near=config["traffic_near"],
        workers=workers,
    )


def _check_room_near(config: Mapping[str, Any], town: Town) -> None:
    """Refuse more vehicles than there are starting places near the given point."""
    near, vehicles = config["traffic_near"], config["vehicles_count"]
    if near is None:
        return
    places = places_near(new_traffic(town, 1, 0), *near).lane_links.start_link.size
    if vehicles > places:
        x, y, radius = near
        raise DrivingError(
            f"vehicles_count is {vehicles}, but within {radius:g} m of ({x:g}, {y:g}) (traffic_near) "
            f"there is room for {places} at most"
        )
