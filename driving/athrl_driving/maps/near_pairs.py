"""Which of many points lie near each other, found by hashing them into cells."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.opendrive.bounds import MOST_CLOSE_POINTS

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def near_pairs(x: Floats, y: Floats, size: float, what: str) -> Iterator[tuple[Integers, Integers]]:
    """Yield ordered pairs (first [n], second [n]) of points [N] among which are all that lie within `size` m.

    They are the pairs of points in the same cell, or in neighbouring ones: so some lie up to three times as
    far apart. Raises `ValueError`, which calls the points `what`, where there are too many pairs.
    """
    column = np.floor((x - x.min()) / size).astype(np.int64) + 1
    row = np.floor((y - y.min()) / size).astype(np.int64) + 1
    columns = int(column.max()) + 2
    cell = row * columns + column
    order = np.argsort(cell, kind="stable")
    sorted_cell = cell[order]
    for shift in (-columns - 1, -columns, -columns + 1, -1, 0, 1, columns - 1, columns, columns + 1):
        begin = np.searchsorted(sorted_cell, cell + shift)
        count = np.searchsorted(sorted_cell, cell + shift, side="right") - begin
        pairs = int(count.sum())
        refuse_many(pairs, MOST_CLOSE_POINTS, f"pairs of {what} lie close together")
        first = np.repeat(np.arange(len(cell)), count)
        within = np.arange(pairs) - np.repeat(np.cumsum(count) - count, count)
        yield first, order[within + np.repeat(begin, count)]


def refuse_many(count: int, most: int, what: str) -> None:
    """Raise `ValueError` where there are more of something than a map may have."""
    if count > most:
        raise ValueError(f"{count:,} {what}, at most {most:,} are allowed")
