"""Which environments of a batch drive in which town, and how much each of them explores."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from athrl_spaces import ranks
from numpy.typing import NDArray


def spread_towns(shares: Mapping[str, float], count: int) -> list[str]:
    """The town of each of `count` environments, by the largest remainder of the shares, interleaved.

    A town with a share gets at least one environment, if there are as many as towns. Of equal remainders the
    first takes precedence.

    Args:
        shares: by town name or path of a map; they need not sum to 1.
        count: of environments.

    Raises:
        ValueError: a share is negative or not finite, none is above 0, or `count` is negative.
    """
    for town, share in shares.items():
        if not (math.isfinite(share) and share >= 0):
            raise ValueError(f"the share of {town} is {share!r}; it should be a finite number, 0 or more")
    total = math.fsum(shares.values())
    if not total > 0:
        raise ValueError("no town has a share; one at least should have one above 0")
    if count < 0:
        raise ValueError(f"the number of environments is {count}; it should be 0 or more")
    numbers = _numbers({town: share / total for town, share in shares.items() if share > 0}, count)
    # The k-th of n environments of a town is placed at (k + 1/2) / n of the batch: evenly for any n.
    places = [((k + 0.5) / n, town) for town, n in numbers.items() for k in range(n)]
    return [town for _, town in sorted(places, key=lambda place: place[0])]


def _numbers(shares: Mapping[str, float], count: int) -> dict[str, int]:
    """How many environments each town gets; the shares sum to 1."""
    exact = {town: share * count for town, share in shares.items()}
    numbers = {town: math.floor(value) for town, value in exact.items()}
    by_remainder = sorted(shares, key=lambda town: numbers[town] - exact[town])
    for town in by_remainder[: count - sum(numbers.values())]:
        numbers[town] += 1
    for town in by_remainder:
        richest = max(numbers, key=lambda other: numbers[other])
        if numbers[town] == 0 and numbers[richest] > 1:
            numbers[town], numbers[richest] = 1, numbers[richest] - 1
    return numbers


def environments_of_towns(towns: Sequence[str]) -> dict[str, NDArray[np.int64]]:
    """The indices of each town's environments, int64 [n], in the order in which the towns first occur."""
    names = np.array(towns, dtype=object)
    return {town: np.flatnonzero(names == town) for town in dict.fromkeys(towns)}


def ranks_within_towns(towns: Sequence[str]) -> NDArray[np.float64]:
    """Rank of each environment among those of its town, float64 [count], evenly from 0 to 1."""
    spread = np.zeros(len(towns))
    for indices in environments_of_towns(towns).values():
        spread[indices] = ranks(len(indices))
    return spread
