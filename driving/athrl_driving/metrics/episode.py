"""Counts an episode tick by tick, and summarises it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from athrl_driving.kernels.compilation import compiled, inlined, prepare
from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.metrics.comfort import judge, remember
from athrl_driving.metrics.state import COMFORT_BOUNDS, NO_COLLISION, WINDOW, MetricsState

COMPLETION_SPEED = 8.0
"""m/s at which an episode of random turns has to be driven to count as complete."""

LEAST_PACE = 0.5
"""m/s over the whole of an episode of random turns, below which an ego has not driven but stood."""

LEAST_TIME_TO_COLLISION = 0.95
"""nuPlan's bound, s."""

LONGEST_TIME_TO_COLLISION = 5.0
"""The summary's value where the time to collision was never shorter, s."""

PENALTIES = (0.60, 0.65, 0.70)
"""CARLA leaderboard's factors for a collision with a vehicle, one with an object, and a red light run."""


@inlined
def reset_metrics(metrics: MetricsState, speed: float, heading: float, goal: float) -> None:
    """Begin an episode of one environment with its ego's speed (m/s) and heading (rad).

    `goal` is the distance to the destination, m; with random turns COMPLETION_SPEED times the time limit.
    """
    metrics.ticks[0] = 0
    metrics.duration[0] = metrics.distance[0] = metrics.lateral[0] = 0.0
    metrics.goal[0] = goal
    metrics.infractions[:] = 0
    metrics.out_of_road[0] = metrics.arrived[0] = metrics.clear_ticks[0] = 0
    metrics.minimum_time_to_collision[0] = math.inf
    metrics.comfortable[:] = 0
    metrics.window[:] = 0.0
    metrics.motion[0], metrics.motion[1] = speed, heading


class TickRecord(NamedTuple):
    """What the metrics need to know of one tick; speed and heading are those at its end."""

    speed: float
    """m/s"""
    heading: float
    """rad; must not jump by full turns."""
    progress: float
    """Distance driven along the route, m."""
    lateral_offset: float
    """Distance from the route, m."""
    time_to_collision: float
    """s"""
    ran_red_light: bool
    collision: int
    """NO_COLLISION, VEHICLE_COLLISION or STATIC_COLLISION."""
    left_lane: bool
    arrived: bool
    duration: float
    """s"""


@inlined
def note_tick(metrics: MetricsState, tick: TickRecord) -> None:
    """Count a tick of one environment."""
    speed, heading, dt = tick.speed, tick.heading, tick.duration
    metrics.ticks[0] += 1
    metrics.duration[0] += dt
    metrics.distance[0] += tick.progress
    metrics.lateral[0] += abs(tick.lateral_offset)
    if tick.collision != NO_COLLISION:
        metrics.infractions[tick.collision - 1] += 1
    metrics.infractions[2] += tick.ran_red_light
    metrics.out_of_road[0] |= tick.left_lane
    metrics.arrived[0] |= tick.arrived
    if tick.time_to_collision < metrics.minimum_time_to_collision[0]:
        metrics.minimum_time_to_collision[0] = tick.time_to_collision
    metrics.clear_ticks[0] += tick.time_to_collision > LEAST_TIME_TO_COLLISION
    turn = (heading - metrics.motion[1]) / dt
    middle_speed = 0.5 * (speed + metrics.motion[0])
    remember(metrics.window, heading, (speed - metrics.motion[0]) / dt, middle_speed * turn)
    metrics.motion[0], metrics.motion[1], metrics.motion[2] = speed, heading, dt
    if metrics.ticks[0] >= WINDOW:
        # The first whole window holds the episode's beginning, later ones are judged at their middle.
        begin = 0 if metrics.ticks[0] == WINDOW else WINDOW // 2
        judge(metrics.window, WINDOW, begin, dt, metrics.comfortable)


@compiled
def _judge_end(window: Floats, ticks: int, dt: float, comfortable: Integers) -> None:
    """Judge the ticks at the episode's end."""
    if ticks >= WINDOW:
        judge(window, WINDOW, WINDOW // 2 + 1, dt, comfortable)
    elif ticks > 0:
        judge(window, ticks, WINDOW - ticks, dt, comfortable)


def prepare_summary(metrics: MetricsState) -> None:
    """Compile or load the kernel that `summary` calls."""
    prepare(_judge_end, metrics.window[0], 0, 0.0, metrics.comfortable[0].copy())


def summary(metrics: MetricsState, environment: int, *, lasted: bool) -> dict[str, float]:
    """Return the metrics of one environment's episode.

    `lasted` means that it had no destination and lasted until the time limit, which then counts as a success
    unless the ego stood. The end of the route, where a map ends, is an arrival as a destination is.
    docs/reference/metrics.md explains each metric. Shares are within 0..1; a rate is 0 or 1 for one episode.
    """
    e = environment
    ticks = int(metrics.ticks[e])
    comfortable = metrics.comfortable[e].copy()
    _judge_end(metrics.window[e], ticks, float(metrics.motion[e, 2]), comfortable)
    shares = comfortable / max(ticks, 1)
    pace = float(metrics.distance[e] / metrics.duration[e]) if ticks else 0.0
    collisions = int(metrics.infractions[e, 0] + metrics.infractions[e, 1])
    crash, out_of_road, arrived = collisions > 0, bool(metrics.out_of_road[e]), bool(metrics.arrived[e])
    completion = 1.0 if arrived else float(np.clip(metrics.distance[e] / metrics.goal[e], 0.0, 1.0))
    penalty = math.prod(
        factor ** int(count) for factor, count in zip(PENALTIES, metrics.infractions[e], strict=True)
    )
    return {
        "driving_score": completion * penalty,
        "route_completion": completion,
        "infraction_penalty": penalty,
        "success": float((arrived or (lasted and pace >= LEAST_PACE)) and not crash and not out_of_road),
        "arrived": float(arrived),
        "crash": float(crash),
        "out_of_road": float(out_of_road),
        "red_lights": float(metrics.infractions[e, 2]),
        **{
            f"comfort_{name}": float(share)
            for name, share in zip((*COMFORT_BOUNDS, "all"), shares, strict=True)
        },
        "time_to_collision_kept": float(metrics.clear_ticks[e] / max(ticks, 1)),
        "minimum_time_to_collision": min(
            float(metrics.minimum_time_to_collision[e]), LONGEST_TIME_TO_COLLISION
        ),
        "mean_speed": pace,
        "mean_lateral_offset": float(metrics.lateral[e] / max(ticks, 1)),
        "distance": float(metrics.distance[e]),
        "duration": float(metrics.duration[e]),
    }
