"""Drivers to compare a policy with; they act through the same waypoint and target speed as a policy."""

from __future__ import annotations

from athrl_spaces import REFERENCE_DRIVERS

from athrl_driving.drivers.blind import BlindRouteFollower
from athrl_driving.drivers.driver import Driver
from athrl_driving.drivers.random_driver import RandomDriver
from athrl_driving.drivers.rule_based import RuleBasedDriver

_RANDOM, _BLIND, _RULE_BASED = REFERENCE_DRIVERS
DRIVERS: dict[str, type[Driver]] = {
    _RANDOM: RandomDriver,
    _BLIND: BlindRouteFollower,
    _RULE_BASED: RuleBasedDriver,
}
"""The drivers by name."""


def make_driver(name: str) -> Driver:
    """Make a driver; raises ValueError that lists the names for one that does not exist."""
    if name not in DRIVERS:
        raise ValueError(f"there is no driver {name!r}, there are {', '.join(DRIVERS)}")
    return DRIVERS[name]()


__all__ = ["DRIVERS", "BlindRouteFollower", "Driver", "RandomDriver", "RuleBasedDriver", "make_driver"]
