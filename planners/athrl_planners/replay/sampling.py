"""Samplers of the replay: uniform, or prioritised by TD error (Schaul et al. 2016).

An item is a sequence or a single decision; padding is never sampled. A sampler allocates its memory with the
first item, as the replay does, so that a replay that is too large can be refused before.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from athrl_planners.replay.sum_tree import SumTree

SMALLEST_PRIORITY = 1e-3
"""Added to every error, so that every item can be sampled again."""


class UniformSampler:
    """Every item is equally likely."""

    def __init__(self, items: int) -> None:
        self._items = items
        self._end = 0

    @cached_property
    def _present(self) -> NDArray[np.bool_]:
        """Whether an item is stored, bool [items]."""
        return np.zeros(self._items, bool)

    def put(self, places: NDArray[np.int64], present: NDArray[np.bool_]) -> None:
        """New items are stored at these indices, or padding where `present` is false."""
        self._present[places] = present
        self._end = max(self._end, int(places.max()) + 1)

    def draw(self, count: int, random: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Indices int64 [count], with replacement, and importance weights float32 [count]."""
        places = random.integers(self._end, size=count)
        while not (present := self._present[places]).all():
            places[~present] = random.integers(self._end, size=int((~present).sum()))
        return places, np.ones(count, np.float32)

    def update_priorities(self, places: NDArray[np.int64], errors: NDArray[np.floating]) -> None:
        """Does nothing: errors have no effect."""

    def state(self) -> dict[str, Any]:
        """What `load_state` needs: nothing."""
        return {}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore `state`, after the same items were put."""


class PrioritisedSampler:
    """Items are sampled in proportion to their last error to the power of `exponent`.

    New items have the highest priority so far. Importance weights correct for the uneven sampling, fully with
    an `importance` of 1: (smallest probability / probability)^importance among the sampled items.
    """

    def __init__(self, items: int, exponent: float, importance: float) -> None:
        self._items = items
        self._exponent, self._importance = exponent, importance
        self._highest = 1.0

    @cached_property
    def _tree(self) -> SumTree:
        """The sum tree of priorities."""
        return SumTree(self._items)

    def put(self, places: NDArray[np.int64], present: NDArray[np.bool_]) -> None:
        """New items are stored at these indices, or padding where `present` is false."""
        self._tree.set(places, np.where(present, self._highest, 0.0))

    def draw(self, count: int, random: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Indices int64 [count], one in each of `count` equal parts of the sum, and their weights [count]."""
        shares = (np.arange(count) + random.random(count)) / count * self._tree.total
        places = self._tree.find(shares)
        weights = self._tree.weights(places)
        importance = (weights.min() / weights) ** self._importance
        return places, importance.astype(np.float32)

    def update_priorities(self, places: NDArray[np.int64], errors: NDArray[np.floating]) -> None:
        """Set priorities from the critics' errors at these indices."""
        there = self._tree.weights(places) > 0
        priorities = (np.abs(errors[there]) + SMALLEST_PRIORITY) ** self._exponent
        if priorities.size:
            self._highest = max(self._highest, float(priorities.max()))
            self._tree.set(places[there], priorities)

    def state(self) -> dict[str, Any]:
        """What `load_state` needs: priorities float64 [items] and the highest so far."""
        return {"priorities": self._tree.all_weights().copy(), "highest": self._highest}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore `state`, after the same items were put.

        An item that has no priority in `state` keeps its own. Raises ValueError for another number of items.
        """
        own, priorities = self._tree.all_weights(), np.asarray(state["priorities"], np.float64)
        if priorities.shape != own.shape:
            raise ValueError(f"it has {priorities.size} priorities, the replay has room for {own.size}")
        self._tree.set(np.arange(own.size), np.where((own > 0) & (priorities > 0), priorities, own))
        self._highest = float(state["highest"])


Sampler = UniformSampler | PrioritisedSampler
