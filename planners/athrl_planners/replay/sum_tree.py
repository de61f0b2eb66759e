"""A sum tree: finds the leaf at a share of the sum of weights in logarithmic time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class SumTree:
    """Weights of `size` leaves, 0 at first. Each call handles many leaves."""

    def __init__(self, size: int) -> None:
        self._levels = max(1, (size - 1).bit_length())
        self._first = 1 << self._levels  # index of the first leaf in the heap
        self._size = size
        self._nodes = np.zeros(2 * self._first)

    @property
    def total(self) -> float:
        """The sum of all weights."""
        return float(self._nodes[1])

    def weights(self, leaves: NDArray[np.int64]) -> NDArray[np.float64]:
        """The weights of some leaves, float64 [n]."""
        return self._nodes[self._first + leaves]

    def all_weights(self) -> NDArray[np.float64]:
        """The weights of all leaves, float64 [size]; a view."""
        return self._nodes[self._first : self._first + self._size]

    def set(self, leaves: NDArray[np.int64], weights: NDArray[np.floating] | float) -> None:
        """Set weights of leaves; of a leaf that occurs twice the last one counts."""
        places = self._first + np.asarray(leaves)
        self._nodes[places] = weights
        places = np.unique(places >> 1)
        while places[0] >= 1:
            self._nodes[places] = self._nodes[2 * places] + self._nodes[2 * places + 1]
            places = np.unique(places >> 1)

    def find(self, shares: NDArray[np.float64]) -> NDArray[np.int64]:
        """The leaf at each share (0 <= share < total) of the sum, int64 [n]."""
        place = np.ones(len(shares), np.int64)
        rest = shares.astype(np.float64)
        for _ in range(self._levels):
            left = 2 * place
            weight = self._nodes[left]
            # To the right only if its sum is positive: rounding may leave a rest beyond the last weight.
            right = (rest >= weight) & (self._nodes[left + 1] > 0)
            rest = np.where(right, rest - weight, np.minimum(rest, weight))
            place = left + right
        return place - self._first
