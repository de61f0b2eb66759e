"""Observations and rewards of each episode, decision by decision, from which transitions are made.

The kernel that draws an image also copies it into the buffer while it is in the core's cache: gathering the
images of a batch afterwards takes ten times as long.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from athrl_spaces import MOTION, REWARD_TERMS
from numpy.typing import NDArray

from athrl_driving.kernels.compilation import part
from athrl_driving.maps.lane_graph import Floats, Integers


class RecordingBuffer(NamedTuple):
    """Buffers of E environments, each for N observations: one more than decisions, or none."""

    seen: NDArray[np.uint8]
    """[E, pixels] the present images of the environments: a view of the same memory."""
    images: NDArray[np.uint8]
    """[E, N, pixels]"""
    motion: NDArray[np.float32]
    """[E, N, m] that belong to the images."""
    rewards: NDArray[np.float32]
    """[E, N] of the decision that led to the observation in the same row."""
    terms: NDArray[np.float32]
    """[E, N, 7] whose sums the rewards are, in the order of `athrl_spaces.REWARD_TERMS`."""
    first: Integers
    """[E] how many decisions of the episode came before the observation in row 0."""


def new_recording_buffer(seen: NDArray[np.uint8], decisions: int) -> RecordingBuffer:
    """Allocate empty buffers for so many decisions each.

    `seen` uint8 [E, S, S, channels] is where the kernel draws. With 0 decisions nothing is recorded.
    """
    count, pixels = len(seen), seen[0].size
    observations = decisions + 1 if decisions else 0
    return RecordingBuffer(
        seen=seen.reshape(count, pixels),
        images=np.zeros((count, observations, pixels), np.uint8),
        motion=np.zeros((count, observations, len(MOTION)), np.float32),
        rewards=np.zeros((count, observations), np.float32),
        terms=np.zeros((count, observations, len(REWARD_TERMS)), np.float32),
        first=np.zeros(count, np.int64),
    )


@part
def record(
    buffer: RecordingBuffer,
    e: int,
    decisions: int,
    motion: NDArray[np.float32],
    reward: float,
    terms: Floats,
) -> None:
    """Put the observation and reward of environment `e` after so many decisions into its buffer, if it fits.

    `motion` is float32 [m], `reward` the sum of `terms`, float64 [7].
    """
    if decisions == 0:
        buffer.first[e] = 0
    row = decisions - buffer.first[e]
    if row >= buffer.images.shape[1]:
        return
    seen, image = buffer.seen[e], buffer.images[e, row]
    for pixel in range(seen.shape[0]):
        image[pixel] = seen[pixel]
    for number in range(motion.shape[0]):
        buffer.motion[e, row, number] = motion[number]
    buffer.rewards[e, row] = reward
    for term in range(terms.shape[0]):
        buffer.terms[e, row, term] = terms[term]
