"""The kinds of action that an environment takes; each is two entries that a planner decides.

| kind | first entry | second entry | controllers |
|---|---|---|---|
| `waypoint` | target speed | the waypoint's angle | PID controllers |
| `waypoint-set` | behaviour: one of three target speeds | one of 16 waypoints | PID controllers |
| `direct` | acceleration | steering | none |
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from athrl_spaces.actions import Action, Continuous, Discrete

WAYPOINT, WAYPOINT_SET, DIRECT = "waypoint", "waypoint-set", "direct"

BEHAVIOURS = {"stop": 0.0, "slow": 0.5, "drive": 1.0}
"""Behaviours of the waypoint set, and their target speeds as shares of the highest."""

DIRECTIONS = 8
"""Directions of the waypoint set, evenly from one outermost angle to the other, left first."""

RADII = (0.5, 1.0)
"""Distances of the waypoint set, as shares of the waypoint's radius; a choice is `radius * 8 + direction`."""

MAXIMUM_ACCELERATION = 3.0
"""m/s2, in both directions."""

MAXIMUM_STEERING = 0.3
"""Steering command at full lock, in both directions; positive to the right."""


@dataclass(frozen=True)
class Limits:
    """Limits of the decisions in an environment.

    Attributes:
        maximum_speed: highest target speed, m/s.
        waypoint_radius: distance of the waypoint, m.
        waypoint_half_angle: angle of the outermost waypoints from straight ahead, rad.
        speed_gain: acceleration towards the target speed for each m/s that is missing, 1/s. The authors'
            release has 0.7, with which a car at walking pace hardly brakes.
    """

    maximum_speed: float = 7.95
    waypoint_radius: float = 8.0
    waypoint_half_angle: float = math.pi / 6
    speed_gain: float = 2.0


@dataclass(frozen=True)
class ActionKind:
    """A kind of action.

    Attributes:
        name: of the kind.
        entries: names of its two entries, in the order in which an environment takes them.
        describe: returns the spaces of both entries under given limits, without exploration.
    """

    name: str
    entries: tuple[str, str]
    describe: Callable[[Limits], tuple[Action, Action]]


def waypoint_directions(half_angle: float) -> tuple[float, ...]:
    """Angles of the waypoint set, rad to the right of straight ahead, from left to right."""
    return tuple(half_angle * (2 * number / (DIRECTIONS - 1) - 1) for number in range(DIRECTIONS))


def _waypoint(limits: Limits) -> tuple[Action, Action]:
    angle = limits.waypoint_half_angle
    return (
        Continuous("target_speed", "m/s", 0.0, limits.maximum_speed),
        Continuous("waypoint_angle", "rad", -angle, angle, sideways=True),
    )


def _waypoint_set(limits: Limits) -> tuple[Action, Action]:
    speeds = tuple(f"{name}: {share * limits.maximum_speed:g} m/s" for name, share in BEHAVIOURS.items())
    places = tuple(
        f"{share * limits.waypoint_radius:g} m at {math.degrees(angle):.1f} degrees"
        for share in RADII
        for angle in waypoint_directions(limits.waypoint_half_angle)
    )
    mirrored = tuple(
        radius * DIRECTIONS + DIRECTIONS - 1 - direction
        for radius in range(len(RADII))
        for direction in range(DIRECTIONS)
    )
    return Discrete("behaviour", speeds), Discrete("waypoint", places, mirrored=mirrored)


def _direct(_: Limits) -> tuple[Action, Action]:
    return (
        Continuous("acceleration", "m/s2", -MAXIMUM_ACCELERATION, MAXIMUM_ACCELERATION),
        Continuous("steering", "", -MAXIMUM_STEERING, MAXIMUM_STEERING, sideways=True),
    )


ACTION_KINDS = {
    kind.name: kind
    for kind in (
        ActionKind(WAYPOINT, ("target_speed", "waypoint_angle"), _waypoint),
        ActionKind(WAYPOINT_SET, ("behaviour", "waypoint"), _waypoint_set),
        ActionKind(DIRECT, ("acceleration", "steering"), _direct),
    )
}
"""The kinds by name; the position of a kind here is its number in compiled code."""


def action_kind(name: str) -> ActionKind:
    """The kind of that name; raises ValueError that lists the known names if there is none."""
    if name not in ACTION_KINDS:
        raise ValueError(f"there is no kind of action {name!r}; there are {', '.join(ACTION_KINDS)}")
    return ACTION_KINDS[name]
