"""A tape of each episode: what was seen and earned, decision by decision, for whoever makes experience of it.

The kernel that draws an image puts it on the tape as well, while it is in the core's cache: to gather the
images of a batch afterwards takes ten times as long.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from athrl_spaces import MOTION, REWARD_TERMS
from numpy.typing import NDArray

from athrl_driving.compilation import part
from athrl_driving.maps.lane_graph import Floats, Integers


class Tape(NamedTuple):
    """The tapes of E environments, each with room for N observations: one more than decisions, or none."""

    seen: NDArray[np.uint8]
    """[E, pixels] the images of the environments as they are: the same memory."""
    images: NDArray[np.uint8]
    """[E, N, pixels]"""
    motion: NDArray[np.float32]
    """[E, N, m] that go with them."""
    rewards: NDArray[np.float32]
    """[E, N] of the decision that led to the observation in the same row."""
    terms: NDArray[np.float32]
    """[E, N, 7] of which they are the sums, in the order of `athrl_spaces.REWARD_TERMS`."""
    first: Integers
    """[E] how many decisions of the episode came before the observation in row 0."""


def new_tape(seen: NDArray[np.uint8], decisions: int) -> Tape:
    """Empty tapes with room for so many decisions each.

    `seen` uint8 [E, S, S, channels] is where the kernel draws. With 0 decisions nothing is recorded.
    """
    count, pixels = len(seen), seen[0].size
    observations = decisions + 1 if decisions else 0
    return Tape(
        seen=seen.reshape(count, pixels),
        images=np.zeros((count, observations, pixels), np.uint8),
        motion=np.zeros((count, observations, len(MOTION)), np.float32),
        rewards=np.zeros((count, observations), np.float32),
        terms=np.zeros((count, observations, len(REWARD_TERMS)), np.float32),
        first=np.zeros(count, np.int64),
    )


@part
def record(
    tape: Tape, e: int, decisions: int, motion: NDArray[np.float32], reward: float, terms: Floats
) -> None:
    """Put what is seen and earned in row `e` after so many decisions on its tape, if there is room.

    `motion` is float32 [m], `reward` the sum of `terms`, float64 [7].
    """
    if decisions == 0:
        tape.first[e] = 0
    row = decisions - tape.first[e]
    if row >= tape.images.shape[1]:
        return
    seen, image = tape.seen[e], tape.images[e, row]
    for pixel in range(seen.shape[0]):
        image[pixel] = seen[pixel]
    for number in range(motion.shape[0]):
        tape.motion[e, row, number] = motion[number]
    tape.rewards[e, row] = reward
    for term in range(terms.shape[0]):
        tape.terms[e, row, term] = terms[term]
