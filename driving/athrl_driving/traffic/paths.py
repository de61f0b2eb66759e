"""Where a background vehicle will go: random turns from each vehicle's own counter, compiled."""

from numba import uint64

from athrl_driving.compilation import inlined
from athrl_driving.maps.lane_graph import LaneGraph
from athrl_driving.traffic.state import PATH_LENGTH, Background

_INCREMENT = 0x9E3779B97F4A7C15


@inlined
def random_below(background: Background, vehicle: int, bound: int) -> int:
    """Return the vehicle's next random number in 0..bound-1 (splitmix64)."""
    state = background.random_state[vehicle] + uint64(_INCREMENT)
    background.random_state[vehicle] = state
    state = (state ^ (state >> uint64(30))) * uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> uint64(27))) * uint64(0x94D049BB133111EB)
    state ^= state >> uint64(31)
    # The upper half is as random as the whole and never negative as a signed number.
    return int((state >> uint64(33)) % uint64(bound))


@inlined
def random_successor(graph: LaneGraph, background: Background, vehicle: int, lane: int) -> int:
    """Return one of the lanes after `lane`, drawn by the vehicle."""
    start = graph.successor_start[lane]
    count = graph.successor_start[lane + 1] - start
    if count == 1:
        return graph.successor[start]
    return graph.successor[start + random_below(background, vehicle, count)]


@inlined
def plan_from(graph: LaneGraph, background: Background, vehicle: int, first: int) -> None:
    """Draw the vehicle's path anew from place `first` of it on; the places before stay."""
    path = background.path
    for place in range(first, PATH_LENGTH):
        path[vehicle, place] = random_successor(graph, background, vehicle, path[vehicle, place - 1])


@inlined
def drop_first(graph: LaneGraph, background: Background, vehicle: int) -> None:
    """Move the path on by one lane."""
    path = background.path
    for place in range(PATH_LENGTH - 1):
        path[vehicle, place] = path[vehicle, place + 1]
    plan_from(graph, background, vehicle, PATH_LENGTH - 1)
