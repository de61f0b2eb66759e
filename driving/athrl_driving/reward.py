"""The task's reward of one tick, term by term.

Weights are the paper's, the terms those of the public gym-carla environment:
`200 r_collision + v + 10 r_fast + 1 r_out + 5 r_steer + 0.2 r_lateral - 0.1`.
"""

from __future__ import annotations

import math

FAST_SPEED = 8.0
"""Speed along the route above which a tick costs, m/s."""

LANE_TOLERANCE = 2.0
"""Lateral distance from the route at which the lane has been left, m."""

REWARD_TERMS = ("collision", "speed", "fast", "out", "steer", "lateral", "constant")
"""Names of the terms, in the order of the sum."""


def tick_reward_terms(
    *, collision: bool, speed: float, heading_error: float, lateral_offset: float, steering: float
) -> dict[str, float]:
    """Weighted terms of one tick; their sum is its reward.

    `speed` is the car's (m/s), `heading_error` its heading less that of the nearest waypoint of the route
    (rad), `lateral_offset` its distance from the route (m), `steering` the commanded value within +-0.3.
    """
    speed_along_route = speed * math.cos(heading_error)
    return {
        "collision": -200.0 if collision else 0.0,
        "speed": speed_along_route,
        "fast": -10.0 if speed_along_route > FAST_SPEED else 0.0,
        "out": -1.0 if has_left_lane(lateral_offset) else 0.0,
        "steer": -5.0 * steering**2,
        "lateral": -0.2 * abs(steering) * speed_along_route**2,
        "constant": -0.1,
    }


def has_left_lane(lateral_offset: float) -> bool:
    """Whether a lateral distance from the route (m) ends the episode."""
    return abs(lateral_offset) > LANE_TOLERANCE
