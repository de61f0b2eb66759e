"""The task's reward of one tick, term by term.

The weights are the paper's; the terms are those of the public gym-carla environment:
`200 r_collision + v + 10 r_fast + 1 r_out + 5 r_steer + 0.2 r_lateral - 0.1`.
"""

from __future__ import annotations

import math

import numpy as np
from athrl_spaces import REWARD_TERMS
from numpy.typing import NDArray

from athrl_driving.kernels.compilation import compiled

_COLLISION, _SPEED, _FAST, _OUT, _STEER, _LATERAL, _CONSTANT = (
    REWARD_TERMS.index(term) for term in ("collision", "speed", "fast", "out", "steer", "lateral", "constant")
)

FAST_SPEED = 8.0
"""Speed along the route above which a tick costs, m/s."""

LANE_TOLERANCE = 2.0
"""Lateral distance from the route at which the lane has been left, m."""


@compiled
def has_left_lane(lateral_offset: float) -> bool:
    """Whether a lateral distance from the route (m) ends the episode."""
    return abs(lateral_offset) > LANE_TOLERANCE


@compiled
def add_reward_terms(
    terms: NDArray[np.float64],
    collision: bool,
    speed: float,
    heading_error: float,
    lateral_offset: float,
    steering: float,
) -> None:
    """Add the weighted terms of one tick to `terms`, float64 [7] as `REWARD_TERMS` names them."""
    speed_along_route = speed * math.cos(heading_error)
    if collision:
        terms[_COLLISION] -= 200.0
    terms[_SPEED] += speed_along_route
    if speed_along_route > FAST_SPEED:
        terms[_FAST] -= 10.0
    if has_left_lane(lateral_offset):
        terms[_OUT] -= 1.0
    terms[_STEER] -= 5.0 * steering * steering
    terms[_LATERAL] -= 0.2 * abs(steering) * speed_along_route * speed_along_route
    terms[_CONSTANT] -= 0.1


def tick_reward_terms(
    *, collision: bool, speed: float, heading_error: float, lateral_offset: float, steering: float
) -> dict[str, float]:
    """Weighted terms of one tick; their sum is its reward.

    `speed` is the car's (m/s), `heading_error` its heading minus that of the nearest waypoint of the route
    (rad), `lateral_offset` its distance from the route (m), `steering` the commanded value within +-0.3.
    """
    terms = np.zeros(len(REWARD_TERMS))
    numbers = (float(speed), float(heading_error), float(lateral_offset), float(steering))
    add_reward_terms(terms, bool(collision), *numbers)
    return dict(zip(REWARD_TERMS, terms.tolist(), strict=True))
