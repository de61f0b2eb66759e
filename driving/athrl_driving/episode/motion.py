"""The observation of the ego's own motion, which accompanies the image, compiled."""

import numpy as np
from numpy.typing import NDArray

from athrl_driving.control import MAXIMUM_STEERING
from athrl_driving.episode.ego import STEERING
from athrl_driving.kernels.compilation import part
from athrl_driving.maps.lane_graph import Floats
from athrl_driving.reward import FAST_SPEED
from athrl_driving.traffic.ego_columns import SPEED

MOTION_LIMIT = 2.0
"""Bound of both entries of `motion`."""


@part
def note_motion(ego: Floats, control: Floats, motion: NDArray[np.float32]) -> None:
    """Write speed / 8 m/s and steering command / 0.3 of an ego to `motion`, float32 [2]."""
    motion[0] = min(max(ego[SPEED] / FAST_SPEED, -MOTION_LIMIT), MOTION_LIMIT)
    motion[1] = min(max(control[STEERING] / MAXIMUM_STEERING, -MOTION_LIMIT), MOTION_LIMIT)
