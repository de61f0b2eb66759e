"""Measures how well traffic flows: speed relative to an empty road, standstill, and collisions.

*Free flow* is the speed that each vehicle would reach alone and without acceleration losses: on every metre
of its path the least of its desired speed, the speed limit and what the curve allows. The share of free flow
is the time that the driven metres would have taken at that speed, divided by the time that they took.
"""

import math
from dataclasses import dataclass

import numpy as np

from athrl_driving.kernels.compilation import compiled, compiled_once, inner, prepare
from athrl_driving.maps import Town
from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.maps.levels import VEHICLE_LEVEL_HEIGHT
from athrl_driving.traffic.columns import Background, Traffic
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
_COUNTS = 2
_SUMS = 4


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
    standing, sums, counts = np.zeros(vehicles), np.zeros(_SUMS), np.zeros(_COUNTS, dtype=np.int64)
    with compiled_once(drive_and_check, "the measurement of traffic", _COMPILE_SECONDS):
        prepare(drive_and_check, traffic, ticks, standing, sums, counts)
    drive_and_check(traffic, ticks, standing, sums, counts)
    time = ticks * TICK * vehicles
    driven, free_time, longest, stood = sums.tolist()
    return Flow(
        mean_speed=driven / time if time else 0.0,
        free_flow_speed=driven / free_time if free_time else 0.0,
        longest_standstill=longest,
        mean_standing=stood / time if time else 0.0,
        colliding_pairs=int(counts[0]),
        lane_changes=int(counts[1]),
        stuck=int((standing > patience(town)).sum()),
    )


def patience(town: Town) -> float:
    """Return the seconds after which a vehicle that stands is stuck: half a minute, and the longest red."""
    signals = town.signals
    green = (signals.green_until - signals.green_from) % np.maximum(signals.cycle, TICK)
    return STUCK + float((signals.cycle - green).max(initial=0.0))


@compiled
def drive(traffic: Traffic, ticks: int) -> None:
    """Let environment 0 drive without an ego, for measuring how long it takes."""
    view = environment_traffic(traffic, 0)
    ego, path = np.zeros(EGO_SIZE), np.full(1, -1)
    for _ in range(ticks):
        advance(view, ego, path, TICK)


@compiled
def drive_and_check(traffic: Traffic, ticks: int, standing: Floats, sums: Floats, counts: Integers) -> None:
    """Let environment 0 drive, and add up what happens in it.

    `standing` [N] is how long each vehicle has stood. `sums`: m driven, s that they take in free flow, the
    longest standstill (s), s stood in all. `counts`: pairs that overlap, lane changes.
    """
    view = environment_traffic(traffic, 0)
    ego, path = np.zeros(EGO_SIZE), np.full(1, -1)
    background, pace = view.background, view.lane_links.pace
    vehicles = background.speed.shape[0]
    changing = np.zeros(vehicles, np.bool_)
    for _ in range(ticks):
        for vehicle in range(vehicles):
            # Traffic moves with the speed from before the tick.
            speed = background.speed[vehicle]
            sums[0] += speed * TICK
            sums[1] += speed * TICK / min(background.desired_speed[vehicle], pace[background.lane[vehicle]])
            standing[vehicle] = standing[vehicle] + TICK if speed < STANDING else 0.0
            sums[2] = max(sums[2], standing[vehicle])
            sums[3] += TICK if speed < STANDING else 0.0
        advance(view, ego, path, TICK)
        for vehicle in range(vehicles):
            now_changing = view.lane_changes.distance[vehicle] > 0.0
            counts[1] += now_changing and not changing[vehicle]
            changing[vehicle] = now_changing
        counts[0] += overlapping_pairs(background)


@compiled
def overlapping_pairs(background: Background) -> int:
    """Count the pairs of an environment's view whose bodies overlap.

    Of two rectangles that overlap, one has a corner in the other or two of their edges cross. On purpose this
    is another test than the one that the simulation uses.
    """
    pairs = 0
    for i in range(background.x.shape[0]):
        for j in range(i):
            reach = background.length[i] + background.length[j]
            if (
                abs(background.x[i] - background.x[j]) < reach
                and abs(background.y[i] - background.y[j]) < reach
                and abs(background.elevation[i] - background.elevation[j]) < VEHICLE_LEVEL_HEIGHT
                and _overlap(_corners(background, i), _corners(background, j))
            ):
                pairs += 1
    return pairs


@inner
def _corners(background: Background, vehicle: int) -> Floats:
    """Return [4, 2] the corners of a vehicle's body."""
    cos, sin = math.cos(background.heading[vehicle]), math.sin(background.heading[vehicle])
    corners = np.empty((4, 2))
    for index in range(4):
        along = 0.5 * background.length[vehicle] * (1.0 if index in (0, 1) else -1.0)
        across = 0.5 * background.width[vehicle] * (1.0 if index in (0, 3) else -1.0)
        corners[index, 0] = background.x[vehicle] + along * cos - across * sin
        corners[index, 1] = background.y[vehicle] + along * sin + across * cos
    return corners


@inner
def _overlap(one: Floats, other: Floats) -> bool:
    """Tell whether two convex quadrilaterals [4, 2] overlap."""
    for i in range(4):
        for j in range(4):
            if _cross(one[i], one[(i + 1) % 4], other[j], other[(j + 1) % 4]):
                return True
    return _inside(one, other[0]) or _inside(other, one[0])


@inner
def _side(a: Floats, b: Floats, point: Floats) -> float:
    return (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0])


@inner
def _cross(a: Floats, b: Floats, c: Floats, d: Floats) -> bool:
    """Tell whether the lines from a to b and from c to d cross; collinear lines do not."""
    return _side(a, b, c) * _side(a, b, d) < 0.0 and _side(c, d, a) * _side(c, d, b) < 0.0


@inner
def _inside(corners: Floats, point: Floats) -> bool:
    """Tell whether a point lies in a convex quadrilateral."""
    least, greatest = math.inf, -math.inf
    for index in range(4):
        side = _side(corners[index], corners[(index + 1) % 4], point)
        least, greatest = min(least, side), max(greatest, side)
    return least >= 0.0 or greatest <= 0.0
