"""Where a background vehicle will go: random turns from each vehicle's own counter, compiled."""

import numpy as np
from numba import uint64
from numpy.typing import NDArray

from athrl_driving.compilation import part
from athrl_driving.traffic.columns import NOBODY, PATH_LENGTH, Background
from athrl_driving.traffic.rails import Rails

_INCREMENT = 0x9E3779B97F4A7C15


@part
def splitmix(state: NDArray[np.uint64]) -> np.uint64:
    """Return the next random 64 bits of a counter [1], which moves on (splitmix64)."""
    mixed = state[0] + uint64(_INCREMENT)
    state[0] = mixed
    mixed = (mixed ^ (mixed >> uint64(30))) * uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> uint64(27))) * uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> uint64(31))


@part
def random_below(background: Background, vehicle: int, bound: int) -> int:
    """Return the vehicle's next random number in 0..bound-1."""
    mixed = splitmix(background.random_state[vehicle : vehicle + 1])
    # The upper half is as random as the whole and never negative as a signed number.
    return int((mixed >> uint64(33)) % uint64(bound))


@part
def plan_from(rails: Rails, background: Background, vehicle: int, first: int) -> None:
    """Draw the vehicle's path anew from place `first` of it on; the places before stay."""
    path = background.path
    link = path[vehicle, first - 1]
    for place in range(first, PATH_LENGTH):
        if link != NOBODY:
            start = rails.next_start[link]
            count = rails.next_start[link + 1] - start
            if count == 0:
                link = NOBODY
            elif count == 1:
                link = rails.next[start]
            else:
                link = rails.next[start + random_below(background, vehicle, count)]
        path[vehicle, place] = link


@part
def drop_first(rails: Rails, background: Background, vehicle: int) -> None:
    """Move the path on by one link."""
    path = background.path
    for place in range(PATH_LENGTH - 1):
        path[vehicle, place] = path[vehicle, place + 1]
    plan_from(rails, background, vehicle, PATH_LENGTH - 1)
