"""What was seen and earned in the environments of a batch, where the simulation has put it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from athrl_driving.episode.tape import Tape


class Recording:
    """The last decisions of each environment, as many as are recorded; views that change with every step.

    A driver that takes its decisions out in time, by `rewind`, misses none. A reset begins at the beginning.

    Attributes:
        images: uint8 [count, recorded + 1, H, W, C]; row n of an environment is what was seen after n
            decisions, row 0 before the first.
        motion: float32 [count, recorded + 1, m] that goes with it.
        rewards: float32 [count, recorded + 1], likewise of the decision before; row 0 is of one that is out.
        terms: float32 [count, recorded + 1, 7], the rewards' terms as `athrl_spaces.REWARD_TERMS` names them.
    """

    def __init__(self, tape: Tape, image_shape: tuple[int, ...]) -> None:
        self._tape = tape
        self.images: NDArray[np.uint8] = tape.images.reshape(*tape.images.shape[:2], *image_shape)
        self.motion, self.rewards, self.terms = tape.motion, tape.rewards, tape.terms

    def state(self) -> dict[str, NDArray]:
        """What `load_state` goes on from: copies."""
        return {name: column.copy() for name, column in self._columns().items()}

    def load_state(self, state: Mapping[str, NDArray]) -> None:
        """Hold what the recording held that `state` is of.

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
            "first": self._tape.first,
        }

    def rewind(self, row: int, decisions: int) -> None:
        """Take the first `decisions` of an environment out: what was seen after them is in row 0 from now on.

        There must be no more than these.
        """
        self.images[row, 0], self.motion[row, 0] = self.images[row, decisions], self.motion[row, decisions]
        self._tape.first[row] += decisions
