"""Where the background vehicles of a new episode start, and how fast."""

import math
from typing import Any

import numpy as np
from numba import uint64
from numpy.typing import NDArray

from athrl_driving.errors import DrivingError
from athrl_driving.kernels.by_reference import by_reference
from athrl_driving.kernels.compilation import entry, part
from athrl_driving.kernels.random_numbers import next_random
from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.traffic.columns import NONE, Traffic
from athrl_driving.traffic.leaders import stopping_speed
from athrl_driving.traffic.paths import plan_from, put_on_link
from athrl_driving.traffic.state import environment_traffic
from athrl_driving.traffic.tick import advance

SLOWEST_DESIRED, FASTEST_DESIRED = 7.0, 9.0
"""m/s between which the vehicles' speeds on a free road lie."""

SIGNAL_SHIFT = 600.0
"""Seconds within which an episode's clock starts, so that signals are at a random time of their cycles."""

Seeds = NDArray[np.uint64]

JITTER = 1.0
"""Metres by which a vehicle starts before or behind its place, at most."""


def place_vehicles(
    traffic: Traffic,
    e: int,
    np_random: np.random.Generator,
    keep_clear_of: tuple[float, float] | None,
    clearance: float,
    ego: Floats,
) -> None:
    """Place all vehicles of environment `e`, none within `clearance` metres of `keep_clear_of`.

    They start with speeds at which they can stop behind each other, behind the ego (float64 [8]) and at their
    stop lines. Raises `ValueError` where the town has no room.
    """
    x, y = keep_clear_of if keep_clear_of is not None else (math.inf, math.inf)
    state = np_random.integers(2**63, size=1, dtype=np.uint64)
    choices = np.empty(traffic.lane_links.start_link.shape[0], np.int64)
    no_path = np.empty(0, np.int64)
    placed = _place_in_environment(traffic, e, state, choices, no_path, x, y, clearance, ego)
    count = traffic.background.lane.shape[1]
    if placed < count:
        raise DrivingError(f"vehicles_count is {count}, but the town has room for {placed} at most")


@entry
def _place_in_environment(
    traffic: Traffic,
    e: int,
    state: Seeds,
    choices: Integers,
    no_path: Integers,
    x: float,
    y: float,
    clearance: float,
    ego: Floats,
) -> int:
    view = by_reference(environment_traffic(by_reference(traffic), e))
    return place(view, state, choices, no_path, x, y, clearance, ego)


@part
def place(
    traffic: Traffic,
    state: Seeds,
    choices: Integers,
    no_path: Integers,
    x: float,
    y: float,
    clearance: float,
    ego: Floats,
) -> int:
    """Place all vehicles of one environment's view and return how many found a place.

    The seed in `state`, uint64 [1], determines everything. No vehicle is placed within `clearance` metres of
    `x`, `y` (infinite: no limit). `choices`, int64 [starting places of `LaneLinks`], is scratch space;
    `no_path`, int64 [0], the ego's path.
    """
    for index in range(choices.shape[0]):
        choices[index] = index
    placed = _choose_places(traffic, state, choices, x, y, clearance)
    if placed == traffic.background.lane.shape[0]:
        advance(traffic, ego, no_path, 0.0)
        _choose_speeds(traffic, state)
    return placed


@part
def _choose_places(
    traffic: Traffic, state: Seeds, choices: Integers, x: float, y: float, clearance: float
) -> int:
    """Put vehicles on starting places drawn from `choices` until all have one; return how many have one."""
    background, changes, lane_links = traffic.background, traffic.lane_changes, traffic.lane_links
    _reset(traffic, _uniform(state) * SIGNAL_SHIFT)
    placed, left = 0, choices.shape[0]
    while placed < background.lane.shape[0] and left > 0:
        drawn = int(_uniform(state) * left)
        left -= 1
        choices[drawn], choices[left] = choices[left], choices[drawn]
        jitter = (2.0 * _uniform(state) - 1.0) * JITTER
        if _put(traffic, placed, choices[left], jitter, x, y, clearance):
            background.random_state[placed] = next_random(state)
            plan_from(lane_links, background, placed, 1)
            span = FASTEST_DESIRED - SLOWEST_DESIRED
            background.desired_speed[placed] = SLOWEST_DESIRED + _uniform(state) * span
            changes.next_decision[placed] = traffic.scratch.clock[0] + _uniform(state)
            placed += 1
    return placed


@part
def _choose_speeds(traffic: Traffic, state: Seeds) -> None:
    """Give each vehicle a speed from which it can still stop behind its leader and before its line."""
    background, lane_links = traffic.background, traffic.lane_links
    for vehicle in range(background.lane.shape[0]):
        pace = min(background.desired_speed[vehicle], lane_links.pace[background.lane[vehicle]])
        safe = stopping_speed(traffic, vehicle)
        background.speed[vehicle] = min((0.5 + 0.5 * _uniform(state)) * pace, safe)


@part
def _uniform(state: Seeds) -> float:
    """Return a random number in [0, 1)."""
    return (next_random(state) >> uint64(11)) * (1.0 / 9007199254740992.0)


@part
def _reset(traffic: Traffic, clock: float) -> None:
    """Reset what the last episode has left, and start the clock."""
    right_of_way, background, changes = traffic.right_of_way, traffic.background, traffic.lane_changes
    right_of_way.crossing[:] = NONE
    right_of_way.granted[:] = NONE
    right_of_way.ahead[:] = NONE
    right_of_way.waiting_since[:] = math.inf
    right_of_way.entry[:] = NONE
    right_of_way.granted_at[:] = 0.0
    right_of_way.inbound[:] = 0
    background.offset[:] = 0.0
    background.speed[:] = 0.0
    background.acceleration[:] = 0.0
    background.crashed[:] = False
    changes.distance[:] = 0.0
    changes.requests_gap[:] = False
    changes.waiting_since[:] = math.inf
    traffic.scratch.clock[0] = clock
    traffic.scratch.grants[:] = 0


@part
def _put(
    traffic: Traffic, vehicle: int, choice: Any, jitter: float, x: float, y: float, clearance: float
) -> bool:
    """Put a vehicle on a starting place; tell whether that is clear."""
    background, lane_links = traffic.background, traffic.lane_links
    position = lane_links.start_position[choice] + jitter
    put_on_link(traffic, vehicle, lane_links.start_link[choice], position)
    return math.hypot(background.x[vehicle] - x, background.y[vehicle] - y) > clearance
