"""Measures how well traffic flows: speed relative to an empty road, standstill, and collisions.

*Free flow* is the speed that each vehicle would reach alone and without acceleration losses: on every metre
of its path the least of its desired speed, the speed limit and what the curve allows. The share of free flow
is the time that the driven metres would have taken at that speed, divided by the time that they took.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.kernels.by_reference import by_reference
from athrl_driving.kernels.compilation import compiled_once, entry, part, prepare
from athrl_driving.maps import Town
from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.maps.levels import VEHICLE_LEVEL_HEIGHT
from athrl_driving.traffic.columns import NONE, Background, Traffic
from athrl_driving.traffic.ego_columns import EGO_SIZE
from athrl_driving.traffic.spawn import place_vehicles
from athrl_driving.traffic.state import environment_traffic, new_traffic
from athrl_driving.traffic.tick import advance

TICK = 0.1
"""Seconds."""

STANDING = 0.1
"""m/s below which a vehicle stands."""

STUCK = 30.0
"""Seconds of standing after which a vehicle counts as stuck, where no light is red for it."""

_COMPILE_SECONDS = 30


@dataclass(frozen=True)
class Flow:
    """The measured values; speeds in m/s, times in s."""

    mean_speed: float
    free_flow_speed: float
    longest_standstill: float
    mean_standing: float
    """Share of the time that a vehicle stands."""
    colliding_pairs: int
    """Pairs that overlap, summed over all ticks."""
    lane_changes: int
    stuck: int
    """Vehicles that at the end have stood for longer than `patience`."""

    @property
    def share_of_free_flow(self) -> float:
        """The mean speed as a share of that in free flow, 0 to 1."""
        return self.mean_speed / self.free_flow_speed if self.free_flow_speed > 0.0 else 1.0


def measure_flow(town: Town, vehicles: int, seed: int, minutes: float) -> Flow:
    """Let traffic without an ego drive for some simulated minutes and check it at every tick.

    Raises `ValueError` where the town has no room for the vehicles.
    """
    traffic = new_traffic(town, 1, vehicles)
    place_vehicles(traffic, 0, np.random.default_rng(seed), None, 0.0, np.zeros(EGO_SIZE))
    ticks = round(60.0 * minutes / TICK)
    watch = _new_watch(vehicles)
    with compiled_once(_drive_and_watch, "the measurement of traffic", _COMPILE_SECONDS):
        prepare(_drive_and_watch, traffic, ticks, watch)
    _drive_and_watch(traffic, ticks, watch)
    time = ticks * TICK * vehicles
    driven, free_time, longest, stood = watch.sums.tolist()
    return Flow(
        mean_speed=driven / time if time else 0.0,
        free_flow_speed=driven / free_time if free_time else 0.0,
        longest_standstill=longest,
        mean_standing=stood / time if time else 0.0,
        colliding_pairs=int(watch.counts[0]),
        lane_changes=int(watch.counts[1]),
        stuck=int((watch.standing > patience(town)).sum()),
    )


def patience(town: Town) -> float:
    """Return the seconds after which a vehicle that stands is stuck: half a minute, and the longest red."""
    signals = town.signals
    green = (signals.green_until - signals.green_from) % np.maximum(signals.cycle, TICK)
    return STUCK + float((signals.cycle - green).max(initial=0.0))


class _Watch(NamedTuple):
    """What is noted of N vehicles while they drive, and scratch space."""

    standing: Floats
    """[N], seconds for which a vehicle has stood."""
    changing: NDArray[np.bool_]
    """[N], whether it is changing lanes."""
    sums: Floats
    """m driven, s that they take in free flow, the longest standstill (s), s stood in all."""
    counts: Integers
    """Pairs that overlap, lane changes."""
    corners: Floats
    """[2, 4, 2], scratch."""
    ego: Floats
    """Absent."""
    path: Integers
    """The ego's path, empty."""


def _new_watch(vehicles: int) -> _Watch:
    return _Watch(
        standing=np.zeros(vehicles),
        changing=np.zeros(vehicles, np.bool_),
        sums=np.zeros(4),
        counts=np.zeros(2, np.int64),
        corners=np.zeros((2, 4, 2)),
        ego=np.zeros(EGO_SIZE),
        path=np.full(1, NONE),
    )


@entry
def _drive_and_watch(traffic: Traffic, ticks: int, watch: _Watch) -> None:
    """Let environment 0 drive without an ego, and add up what happens in it."""
    view = by_reference(environment_traffic(by_reference(traffic), 0))
    background, pace = view.background, view.lane_links.pace
    standing, changing, sums, counts = watch.standing, watch.changing, watch.sums, watch.counts
    vehicles = background.speed.shape[0]
    for _ in range(ticks):
        for vehicle in range(vehicles):
            # Traffic moves with the speed from before the tick.
            speed = background.speed[vehicle]
            sums[0] += speed * TICK
            sums[1] += speed * TICK / min(background.desired_speed[vehicle], pace[background.lane[vehicle]])
            standing[vehicle] = standing[vehicle] + TICK if speed < STANDING else 0.0
            sums[2] = max(sums[2], standing[vehicle])
            sums[3] += TICK if speed < STANDING else 0.0
        advance(view, watch.ego, watch.path, TICK)
        for vehicle in range(vehicles):
            now_changing = view.lane_changes.distance[vehicle] > 0.0
            counts[1] += now_changing and not changing[vehicle]
            changing[vehicle] = now_changing
        counts[0] += _count_overlapping(background, watch.corners)


def drive(traffic: Traffic, ticks: int) -> None:
    """Let environment 0 drive without an ego, for measuring how long it takes."""
    _drive(traffic, ticks, np.zeros(EGO_SIZE), np.full(1, NONE))


@entry
def _drive(traffic: Traffic, ticks: int, ego: Floats, path: Integers) -> None:
    view = by_reference(environment_traffic(by_reference(traffic), 0))
    for _ in range(ticks):
        advance(view, ego, path, TICK)


def overlapping_pairs(background: Background) -> int:
    """Count the pairs of an environment's view whose bodies overlap.

    Of two rectangles that overlap, one has a corner in the other or two of their edges cross. On purpose this
    is another test than the one that the simulation uses.
    """
    return int(_overlapping_pairs(background, np.zeros((2, 4, 2))))


@entry
def _overlapping_pairs(background: Background, corners: Floats) -> int:
    return _count_overlapping(by_reference(background), corners)


@part
def _count_overlapping(background: Background, corners: Floats) -> int:
    pairs = 0
    for i in range(background.x.shape[0]):
        for j in range(i):
            reach = background.length[i] + background.length[j]
            if (
                abs(background.x[i] - background.x[j]) < reach
                and abs(background.y[i] - background.y[j]) < reach
                and abs(background.elevation[i] - background.elevation[j]) < VEHICLE_LEVEL_HEIGHT
            ):
                _set_corners(background, i, corners[0])
                _set_corners(background, j, corners[1])
                pairs += _overlap(corners[0], corners[1])
    return pairs


@part
def _set_corners(background: Background, vehicle: int, corners: Floats) -> None:
    """Write the corners of a vehicle's body, [4, 2]."""
    cos, sin = math.cos(background.heading[vehicle]), math.sin(background.heading[vehicle])
    for index in range(4):
        along = 0.5 * background.length[vehicle] * (1.0 if index in (0, 1) else -1.0)
        across = 0.5 * background.width[vehicle] * (1.0 if index in (0, 3) else -1.0)
        corners[index, 0] = background.x[vehicle] + along * cos - across * sin
        corners[index, 1] = background.y[vehicle] + along * sin + across * cos


@part
def _overlap(one: Floats, other: Floats) -> bool:
    """Tell whether two convex quadrilaterals [4, 2] overlap."""
    for i in range(4):
        for j in range(4):
            if _cross(one[i], one[(i + 1) % 4], other[j], other[(j + 1) % 4]):
                return True
    return _inside(one, other[0]) or _inside(other, one[0])


@part
def _side(a: Floats, b: Floats, point: Floats) -> float:
    return (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0])


@part
def _cross(a: Floats, b: Floats, c: Floats, d: Floats) -> bool:
    """Tell whether the lines from a to b and from c to d cross; collinear lines do not."""
    return _side(a, b, c) * _side(a, b, d) < 0.0 and _side(c, d, a) * _side(c, d, b) < 0.0


@part
def _inside(corners: Floats, point: Floats) -> bool:
    """Tell whether a point lies in a convex quadrilateral."""
    least, greatest = math.inf, -math.inf
    for index in range(4):
        side = _side(corners[index], corners[(index + 1) % 4], point)
        least, greatest = min(least, side), max(greatest, side)
    return least >= 0.0 or greatest <= 0.0
