"""Observations of environments, in memory that the episodes of several towns may share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from athrl_spaces import CHANNELS, MOTION
from numpy.typing import NDArray

from athrl_driving.episode.recording_buffer import RecordingBuffer, new_recording_buffer
from athrl_driving.maps.lane_graph import Integers


class ObservationArrays(NamedTuple):
    """Observations and recording buffers of B environments, of which these episodes use E <= B."""

    env_index: Integers
    """[E] the index of each episode's environment in the batch; the others belong to other `Episodes`."""
    images: NDArray[np.uint8]
    """[B, S, S, channels]"""
    motion: NDArray[np.float32]
    """[B, m] as `athrl_spaces.MOTION` names it, within +-2."""
    recording_buffer: RecordingBuffer
    """Of B environments."""


def new_observation_arrays(environments: int, image_size: int, decisions: int) -> ObservationArrays:
    """Allocate observations of so many environments, and recording buffers of so many decisions."""
    images = np.zeros((environments, image_size, image_size, len(CHANNELS)), np.uint8)
    motion = np.zeros((environments, len(MOTION)), np.float32)
    return ObservationArrays(np.arange(environments), images, motion, new_recording_buffer(images, decisions))
