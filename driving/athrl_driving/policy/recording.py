"""Observations and rewards of the environments of a batch, where the simulation has recorded them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from athrl_driving.episode.recording_buffer import RecordingBuffer


class Recording:
    """The last recorded decisions of each environment; views that change with every step.

    A caller that removes decisions in time, by `rewind`, misses none. A reset starts the recording again.

    Attributes:
        images: uint8 [count, recorded + 1, H, W, C]; row n of an environment is the observation after n
            decisions, row 0 that before the first.
        motion: float32 [count, recorded + 1, m] that belongs to the images.
        rewards: float32 [count, recorded + 1] of the decision before each observation; that in row 0 belongs
            to a decision that has been removed.
        terms: float32 [count, recorded + 1, 7], the rewards' terms as `athrl_spaces.REWARD_TERMS` names them.
    """

    def __init__(self, buffer: RecordingBuffer, image_shape: tuple[int, ...]) -> None:
        self._buffer = buffer
        self.images: NDArray[np.uint8] = buffer.images.reshape(*buffer.images.shape[:2], *image_shape)
        self.motion, self.rewards, self.terms = (
            buffer.motion,
            buffer.rewards,
            buffer.terms,
        )

    def state(self) -> dict[str, NDArray]:
        """The state for `load_state`: copies."""
        return {name: column.copy() for name, column in self._columns().items()}

    def load_state(self, state: Mapping[str, NDArray]) -> None:
        """Restore the recording that `state` was taken from.

        Raises:
            KeyError, ValueError: `state` does not fit.
        """
        for name, column in self._columns().items():
            column[:] = state[name]

    def _columns(self) -> dict[str, NDArray]:
        return {
            "images": self.images,
            "motion": self.motion,
            "rewards": self.rewards,
            "terms": self.terms,
            "first": self._buffer.first,
        }

    def rewind(self, env_index: int, decisions: int) -> None:
        """Remove the first `decisions` of an environment: the observation after them moves to row 0.

        The environment must have recorded no more than these.
        """
        images, motion = self.images[env_index], self.motion[env_index]
        images[0], motion[0] = images[decisions], motion[decisions]
        self._buffer.first[env_index] += decisions
