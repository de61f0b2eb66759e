"""Lines and arcs as curves of constant curvature, compiled."""

import math

from athrl_driving.kernels.compilation import inlined


@inlined
def pose_on_arc(
    x: float, y: float, heading: float, curvature: float, length: float
) -> tuple[float, float, float]:
    """Return the pose (m, m, rad) `length` metres along an arc or, with curvature 0 (1/m), a line."""
    # The chord of an arc lies along the mean of its two headings.
    half = 0.5 * curvature * length
    chord = length if abs(half) < 1e-12 else length * math.sin(half) / half
    middle = heading + half
    return x + chord * math.cos(middle), y + chord * math.sin(middle), middle + half
