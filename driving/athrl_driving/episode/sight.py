"""What environments see, in memory that the episodes of several towns may have in common."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from athrl_spaces import CHANNELS, MOTION
from numpy.typing import NDArray

from athrl_driving.episode.tape import Tape, new_tape
from athrl_driving.maps.lane_graph import Integers


class Sight(NamedTuple):
    """What B environments see, and their tapes; each of E <= B episodes writes to its own row alone."""

    rows: Integers
    """[E] the row of each episode; the others belong to episodes elsewhere."""
    images: NDArray[np.uint8]
    """[B, S, S, channels]"""
    motion: NDArray[np.float32]
    """[B, m] as `athrl_spaces.MOTION` names it, within +-2."""
    tape: Tape
    """Of B environments."""


def new_sight(environments: int, image_size: int, decisions: int) -> Sight:
    """Room for what so many environments see, and for tapes of so many decisions."""
    images = np.zeros((environments, image_size, image_size, len(CHANNELS)), np.uint8)
    motion = np.zeros((environments, len(MOTION)), np.float32)
    return Sight(np.arange(environments), images, motion, new_tape(images, decisions))
