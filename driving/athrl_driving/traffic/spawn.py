"""Where the background vehicles of a new episode start, and how fast."""

import math
from typing import Any

import numpy as np
from numba import uint64
from numpy.typing import NDArray

from athrl_driving.by_reference import by_reference
from athrl_driving.compilation import compiled, inner, part
from athrl_driving.errors import DrivingError
from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.traffic.columns import NOBODY, Traffic
from athrl_driving.traffic.geometry import lane_elevation, lane_pose
from athrl_driving.traffic.paths import plan_from, splitmix
from athrl_driving.traffic.rails import CURVE_BRAKING
from athrl_driving.traffic.state import environment_traffic
from athrl_driving.traffic.tick import LINE_MARGIN, advance

SLOWEST_DESIRED, FASTEST_DESIRED = 7.0, 9.0
"""m/s between which everybody's speed on a free road lies."""

SIGNAL_SHIFT = 600.0
"""Seconds within which an episode's clock starts, so that signals are anywhere in their cycles."""

Seeds = NDArray[np.uint64]

_JITTER = 1.0
_STANDSTILL_ROOM = 2.0
_REACTION_ROOM = 1.0


def place_vehicles(
    traffic: Traffic,
    e: int,
    np_random: np.random.Generator,
    keep_clear_of: tuple[float, float] | None,
    clearance: float,
    ego: Floats,
) -> None:
    """Place every vehicle of environment `e` anew, none within `clearance` metres of `keep_clear_of`.

    They start with speeds at which they can stop behind each other, behind the ego (float64 [8]) and at their
    stop lines. Raises `ValueError` where the town has no room.
    """
    x, y = keep_clear_of if keep_clear_of is not None else (math.inf, math.inf)
    seed = np_random.integers(2**63, dtype=np.uint64)
    placed = _place_in_environment(traffic, e, seed, x, y, clearance, ego)
    count = traffic.background.lane.shape[1]
    if placed < count:
        raise DrivingError(f"vehicles_count is {count}, but the town has room for {placed} at most")


@compiled
def _place_in_environment(
    traffic: Traffic, e: int, seed: np.uint64, x: float, y: float, clearance: float, ego: Floats
) -> int:
    return place(environment_traffic(traffic, e), seed, x, y, clearance, ego)


@inner
def place(traffic: Traffic, seed: np.uint64, x: float, y: float, clearance: float, ego: Floats) -> int:
    """Place every vehicle of one environment's view anew and return how many found a place.

    `seed` decides everything; none comes within `clearance` metres of `x`, `y` (infinite: of nothing).
    """
    state, choices = np.full(1, seed, np.uint64), np.empty(traffic.rails.start_link.shape[0], np.int64)
    return place_with(by_reference(traffic), state, choices, np.empty(0, np.int64), x, y, clearance, ego)


@part
def place_with(
    traffic: Traffic,
    state: Seeds,
    choices: Integers,
    no_path: Integers,
    x: float,
    y: float,
    clearance: float,
    ego: Floats,
) -> int:
    """Do what `place` does where no arrays can be made: `state` is uint64 [1], the seed.

    `choices` int64 [starting places of `Rails`] is room to work in, `no_path` int64 [0] the ego's path.
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
    """Put vehicles on places drawn from `choices` until all have one; return how many have."""
    background, changes, rails = traffic.background, traffic.lane_changes, traffic.rails
    _forget(traffic, _uniform(state) * SIGNAL_SHIFT)
    placed, left = 0, choices.shape[0]
    while placed < background.lane.shape[0] and left > 0:
        drawn = int(_uniform(state) * left)
        left -= 1
        choices[drawn], choices[left] = choices[left], choices[drawn]
        jitter = (2.0 * _uniform(state) - 1.0) * _JITTER
        if _put(traffic, placed, choices[left], jitter, x, y, clearance):
            background.random_state[placed] = splitmix(state)
            plan_from(rails, background, placed, 1)
            span = FASTEST_DESIRED - SLOWEST_DESIRED
            background.desired_speed[placed] = SLOWEST_DESIRED + _uniform(state) * span
            changes.next_thought[placed] = traffic.scratch.clock[0] + _uniform(state)
            placed += 1
    return placed


@part
def _choose_speeds(traffic: Traffic, state: Seeds) -> None:
    """Give everybody a speed with which it can still stop behind its leader and before its line."""
    background, rails, scratch = traffic.background, traffic.rails, traffic.scratch
    for row in range(background.lane.shape[0]):
        pace = min(background.desired_speed[row], rails.pace[background.lane[row]])
        line = traffic.right_of_way.line_distance[row] - LINE_MARGIN
        end = rails.room[background.path[row, 0]] - scratch.position[row] - 0.5 * background.length[row]
        room = max(min(scratch.gap[row] - _STANDSTILL_ROOM, line, end) - _REACTION_ROOM, 0.0)
        safe = math.sqrt(2.0 * CURVE_BRAKING * room)
        background.speed[row] = min((0.5 + 0.5 * _uniform(state)) * pace, safe)


@part
def _uniform(state: Seeds) -> float:
    """Return a random number in [0, 1)."""
    return (splitmix(state) >> uint64(11)) * (1.0 / 9007199254740992.0)


@part
def _forget(traffic: Traffic, clock: float) -> None:
    """Clear what an episode before has left, and start the clock."""
    right_of_way, background, changes = traffic.right_of_way, traffic.background, traffic.lane_changes
    right_of_way.crossing[:] = NOBODY
    right_of_way.granted[:] = NOBODY
    right_of_way.ahead[:] = NOBODY
    right_of_way.waiting_since[:] = math.inf
    right_of_way.granted_at[:] = 0.0
    right_of_way.inbound[:] = 0
    background.offset[:] = 0.0
    background.speed[:] = 0.0
    background.acceleration[:] = 0.0
    background.crashed[:] = False
    changes.over[:] = 0.0
    changes.asks[:] = False
    changes.wanted_since[:] = math.inf
    traffic.scratch.clock[0] = clock
    traffic.scratch.turns[:] = 0


@part
def _put(
    traffic: Traffic, row: int, choice: Any, jitter: float, x: float, y: float, clearance: float
) -> bool:
    """Put a vehicle on a starting place, if that is clear."""
    background, rails, graph = traffic.background, traffic.rails, traffic.graph
    link, position = rails.start_link[choice], rails.start_position[choice] + jitter
    index = rails.row_start[link]
    lane = rails.rows[index]
    while position > rails.link_offset[lane] + graph.length[lane] and index + 1 < rails.row_start[link + 1]:
        index += 1
        lane = rails.rows[index]
    s = position - rails.link_offset[lane]
    place_x, place_y, heading = lane_pose(graph, lane, s)
    if math.hypot(place_x - x, place_y - y) <= clearance:
        return False
    background.lane[row], background.s[row], background.path[row, 0] = lane, s, link
    background.x[row], background.y[row], background.heading[row] = place_x, place_y, heading
    background.elevation[row] = lane_elevation(graph, lane, s)
    return True
