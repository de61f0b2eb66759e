"""Lists of variable length as two arrays, as kernels read them."""

from collections.abc import Sequence

import numpy as np

from athrl_driving.maps.lane_graph import Integers


def compressed(lists: Sequence[Sequence[int]]) -> tuple[Integers, Integers]:
    """Return (start [n + 1], values): list `i` is `values[start[i]:start[i + 1]]`."""
    start = np.concatenate([[0], np.cumsum([len(values) for values in lists])]).astype(np.int64)
    return start, np.array([value for values in lists for value in values], dtype=np.int64)
