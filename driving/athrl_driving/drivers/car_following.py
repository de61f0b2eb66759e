"""The intelligent driver model behind a leader or towards a stop line."""

from __future__ import annotations

import math

COMFORTABLE_ACCELERATION = 2.0
"""m/s2"""

COMFORTABLE_BRAKING = 2.0
"""m/s2"""

HEADWAY = 1.2
"""Time kept to the leader, s."""

STANDSTILL_GAP = 2.5
"""Distance kept to a standing leader or to the stop line, m."""


def following_acceleration(speed: float, desired_speed: float, gap: float, leader_speed: float) -> float:
    """Acceleration of the intelligent driver model, m/s2; speeds in m/s, gap in m, inf without a leader."""
    braking = 2.0 * math.sqrt(COMFORTABLE_ACCELERATION * COMFORTABLE_BRAKING)
    wanted = STANDSTILL_GAP + max(0.0, speed * HEADWAY + speed * (speed - leader_speed) / braking)
    share = wanted / max(gap, 0.1)
    return COMFORTABLE_ACCELERATION * (1.0 - (speed / desired_speed) ** 4 - share**2)


def is_safe_behind(gap: float, speed: float, leader_speed: float) -> bool:
    """Tell whether a gap (m) is enough to move in behind a leader without more than comfortable braking."""
    closing = max(speed**2 - leader_speed**2, 0.0) / (2.0 * COMFORTABLE_BRAKING)
    return gap > STANDSTILL_GAP + 0.6 * speed + closing
