"""Random numbers for kernels: splitmix64, whose state is one counter."""

import numpy as np
from numba import uint64
from numpy.typing import NDArray

from athrl_driving.kernels.compilation import inlined

_INCREMENT = 0x9E3779B97F4A7C15


@inlined
def next_random(state: NDArray[np.uint64]) -> np.uint64:
    """Return the next random 64 bits of a counter [1], and advance it."""
    mixed = state[0] + uint64(_INCREMENT)
    state[0] = mixed
    mixed = (mixed ^ (mixed >> uint64(30))) * uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> uint64(27))) * uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> uint64(31))


@inlined
def random_below(state: NDArray[np.uint64], bound: int) -> int:
    """Return the next random whole number in 0..bound-1 of a counter [1]."""
    # The upper half is as random as the whole and never negative as a signed number.
    return int((next_random(state) >> uint64(33)) % uint64(bound))
