"""What a viewer or a recording needs to know about one moment of an episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps import load_town


@dataclass(frozen=True)
class VehiclePose:
    """A vehicle's position, motion and size."""

    x: float
    """m"""
    y: float
    """m, downwards"""
    heading: float
    """rad, growing to the driver's right"""
    speed: float
    """m/s"""
    length: float
    """m"""
    width: float
    """m"""


@dataclass(frozen=True)
class Scene:
    """A moment of an episode, in town coordinates."""

    step: int
    """Decisions since the episode began."""
    time: float
    """Simulated seconds since the episode began."""
    ego: VehiclePose
    vehicles: tuple[VehiclePose, ...]
    route: NDArray[np.float64]
    """[12, 2] the next waypoints of the route, m."""
    waypoint: NDArray[np.float64] | None
    """[2] the planner's waypoint, m, or the ego's own position before the first decision; None where the
    planner decides acceleration and steering."""
    target_speed: float
    """m/s; NaN where the planner decides acceleration and steering."""
    steering: float
    """Angle of the front wheels, rad, positive to the right."""
    acceleration: float
    """m/s2"""
    reward: float
    """Of the last decision."""
    reward_terms: dict[str, float]
    """Weighted terms that sum to the reward."""


def lane_polylines(town: str) -> list[NDArray[np.float64]]:
    """Centre lines of a town's lanes, each float64 [n, 2] in metres, for drawing."""
    return load_town(town).lane_polylines()
