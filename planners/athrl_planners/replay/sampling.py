"""Which stored pieces are drawn: evenly, or by how much was to be learnt from them (Schaul et al. 2016).

A piece is a sequence or a single decision; padding is never drawn. A sampler takes its memory with the first
piece, as the replay does, so that one beyond this machine can be refused before.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from athrl_planners.replay.sum_tree import SumTree

SMALLEST_PRIORITY = 1e-3
"""Added to every error, so that nothing is never drawn again."""


class UniformSampler:
    """Every piece is equally likely."""

    def __init__(self, pieces: int) -> None:
        self._pieces = pieces
        self._end = 0

    @cached_property
    def _present(self) -> NDArray[np.bool_]:
        """Where something is stored, bool [pieces]."""
        return np.zeros(self._pieces, bool)

    def put(self, places: NDArray[np.int64], present: NDArray[np.bool_]) -> None:
        """Something new is stored at these places, or nothing where it is not `present`."""
        self._present[places] = present
        self._end = max(self._end, int(places.max()) + 1)

    def draw(self, count: int, random: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Places int64 [count], with replacement, and their importance float32 [count]."""
        places = random.integers(self._end, size=count)
        while not (present := self._present[places]).all():
            places[~present] = random.integers(self._end, size=int((~present).sum()))
        return places, np.ones(count, np.float32)

    def learnt(self, places: NDArray[np.int64], errors: NDArray[np.floating]) -> None:
        """Errors make no difference here."""

    def state(self) -> dict[str, Any]:
        """What `load_state` needs: nothing."""
        return {}

    def load_state(self, state: dict[str, Any]) -> None:
        """Be where the sampler was that `state` is of, after the same pieces were put."""


class PrioritisedSampler:
    """A piece is drawn in proportion to its last error to the power of `exponent`.

    What is new has the highest priority so far. Importance corrects for the unevenness, fully with an
    `importance` of 1: (smallest probability / probability)^importance of those drawn.
    """

    def __init__(self, pieces: int, exponent: float, importance: float) -> None:
        self._pieces = pieces
        self._exponent, self._importance = exponent, importance
        self._highest = 1.0

    @cached_property
    def _tree(self) -> SumTree:
        """The priorities."""
        return SumTree(self._pieces)

    def put(self, places: NDArray[np.int64], present: NDArray[np.bool_]) -> None:
        """Something new is stored at these places, or nothing where it is not `present`."""
        self._tree.set(places, np.where(present, self._highest, 0.0))

    def draw(self, count: int, random: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Places int64 [count], one in each of `count` equal parts of the sum, and importance [count]."""
        shares = (np.arange(count) + random.random(count)) / count * self._tree.total
        places = self._tree.find(shares)
        weights = self._tree.weights(places)
        importance = (weights.min() / weights) ** self._importance
        return places, importance.astype(np.float32)

    def learnt(self, places: NDArray[np.int64], errors: NDArray[np.floating]) -> None:
        """Remember how wrong the critics were about the pieces at `places`."""
        there = self._tree.weights(places) > 0
        priorities = (np.abs(errors[there]) + SMALLEST_PRIORITY) ** self._exponent
        if priorities.size:
            self._highest = max(self._highest, float(priorities.max()))
            self._tree.set(places[there], priorities)

    def state(self) -> dict[str, Any]:
        """What `load_state` needs: priorities float64 [pieces] and the highest so far."""
        return {"priorities": self._tree.all_weights().copy(), "highest": self._highest}

    def load_state(self, state: dict[str, Any]) -> None:
        """Be where the sampler was that `state` is of, after the same pieces were put.

        What is stored here and had no priority there keeps its own. Raises ValueError if it is of another
        number of pieces.
        """
        own, priorities = self._tree.all_weights(), np.asarray(state["priorities"], np.float64)
        if priorities.shape != own.shape:
            raise ValueError(f"it has {priorities.size} priorities, the replay has room for {own.size}")
        self._tree.set(np.arange(own.size), np.where((own > 0) & (priorities > 0), priorities, own))
        self._highest = float(state["highest"])


Sampler = UniformSampler | PrioritisedSampler
