"""The counts of each environment's episode, updated at every tick."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from athrl_driving.kernels.environment_views import view_maker
from athrl_driving.maps.lane_graph import Floats, Integers

WINDOW = 15
"""Ticks over which motion is smoothed before jerk and turning are taken from it, as in nuPlan."""

COMFORT_BOUNDS = (
    "longitudinal_acceleration",
    "lateral_acceleration",
    "yaw_rate",
    "yaw_acceleration",
    "longitudinal_jerk",
    "jerk",
)
"""nuPlan's bounds, in the order in which the ticks within them are counted; then the ticks within all."""

NO_COLLISION, VEHICLE_COLLISION, STATIC_COLLISION = 0, 1, 2
"""What a tick's collision was with."""

HEADING, LONGITUDINAL, LATERAL, MAGNITUDE = range(4)
"""Columns of `window`."""


class MetricsState(NamedTuple):
    """The counts of E environments, or without that axis those of one (see `environment_metrics`)."""

    ticks: Integers
    """[E] since the episode began."""
    duration: Floats
    """[E] s."""
    distance: Floats
    """[E] m along the route."""
    goal: Floats
    """[E] m, length of the whole route."""
    lateral: Floats
    """[E] sum over ticks of the distance from the route, m."""
    infractions: Integers
    """[E, 3] collisions with vehicles, collisions with static objects, red lights run."""
    out_of_road: Integers
    """[E] 1 once the lane has been left."""
    arrived: Integers
    """[E] 1 once the destination, or the end of the route where the map ends, has been reached."""
    minimum_time_to_collision: Floats
    """[E] s."""
    clear_ticks: Integers
    """[E] ticks with a time to collision above the bound."""
    comfortable: Integers
    """[E, 7] ticks within each of COMFORT_BOUNDS and within all of them, as far as they are judged yet."""
    window: Floats
    """[E, WINDOW, 4] the latest ticks: heading (rad), longitudinal, lateral and whole acceleration (m/s2)."""
    motion: Floats
    """[E, 3] speed (m/s) and heading (rad) at the last tick, and a tick's duration (s)."""


def new_metrics(environments: int) -> MetricsState:
    """Make room for the counts of a number of environments."""
    count = environments
    return MetricsState(
        ticks=np.zeros(count, np.int64),
        duration=np.zeros(count),
        distance=np.zeros(count),
        goal=np.ones(count),
        lateral=np.zeros(count),
        infractions=np.zeros((count, 3), np.int64),
        out_of_road=np.zeros(count, np.int64),
        arrived=np.zeros(count, np.int64),
        minimum_time_to_collision=np.full(count, np.inf),
        clear_ticks=np.zeros(count, np.int64),
        comfortable=np.zeros((count, len(COMFORT_BOUNDS) + 1), np.int64),
        window=np.zeros((count, WINDOW, 4)),
        motion=np.zeros((count, 3)),
    )


environment_metrics = view_maker(
    MetricsState,
    numbers=[
        *("ticks", "duration", "distance", "goal", "lateral", "out_of_road", "arrived"),
        *("minimum_time_to_collision", "clear_ticks"),
    ],
)
"""(metrics, environment) -> the counts of one environment: the same memory without the first axis."""
