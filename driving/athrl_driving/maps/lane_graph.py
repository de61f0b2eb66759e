"""A town's lanes as arrays: what kernels read.

Every lane of the graph is exactly a straight line or a circular arc. Junctions are crossed on *movements*: a
movement is the chain of lanes, usually one to three, from an incoming lane to an outgoing one. It is what a
vehicle reserves.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

TURN_LEFT, TURN_STRAIGHT, TURN_RIGHT = 0, 1, 2

GRID_CELL = 16.0
"""Metres: the side of a cell of the lane graph's grid."""


class LaneGraph(NamedTuple):
    """The L lanes (C-contiguous arrays; numba takes the tuple as it is).

    Lists of variable length are in compressed form: those of lane `i` are `values[start[i]:start[i + 1]]`.
    """

    curvature: Floats
    """[L] 1/m; 0 on straight lanes, positive where the heading grows (a turn to the driver's right)."""
    start_x: Floats
    """[L] m."""
    start_y: Floats
    """[L] m."""
    start_heading: Floats
    """[L] rad, within [-pi, pi)."""
    length: Floats
    """[L] m, along the centre line."""
    width: Floats
    """[L] m, the mean over the lane."""
    elevation: Floats
    """[L] m above the map's zero, at the lane's start."""
    grade: Floats
    """[L] m per m: `elevation + grade * s` is the height at `s` metres, within 0.3 m."""
    speed_limit: Floats
    """[L] m/s."""
    successor_start: Integers
    """[L+1]."""
    successor: Integers
    """[S] lanes that follow; a lane without one is a `dead_end`, or the road `leaves` the map."""
    dead_end: NDArray[np.bool_]
    """[L] the lane ends here: a vehicle has to change to a neighbour before its end."""
    enters: NDArray[np.bool_]
    """[L] the lane's road enters the map at its start: background vehicles enter there."""
    leaves: NDArray[np.bool_]
    """[L] the lane's road leaves the map at its end: background vehicles leave there."""
    junction: Integers
    """[L] -1 on ordinary lanes, else the number of the junction that the lane's movement belongs to."""
    turn: Integers
    """[L] 0 left, 1 straight, 2 right; 1 on ordinary lanes. A roundabout is entered and left to the right."""
    left: Integers
    """[L] the lane on the left, in the same direction, that a vehicle may change to, or -1.

    Lanes beside each other cover the same part of the road: `s` on one is `s * length[other] / length` on the
    other. Lanes of movements have no neighbours.
    """
    right: Integers
    """[L] the lane on the right that a vehicle may change to, as `left`."""
    start_cos: Floats
    """[L] cosine of `start_heading`."""
    start_sin: Floats
    """[L] sine of `start_heading`."""
    box: Floats
    """[L, 4] least x, least y, greatest x, greatest y of the lane's surface, m."""
    movement: Integers
    """[L] the movement that the lane belongs to, -1 on ordinary lanes."""
    movement_offset: Floats
    """[L] m driven on the movement before the lane starts; 0 on ordinary lanes."""
    grid_origin: Floats
    """[2] x and y (m) of the grid's corner with the least coordinates; cells are `GRID_CELL` wide."""
    grid_shape: Integers
    """[2] columns (along x) and rows (along y) of the grid."""
    grid_start: Integers
    """[cells + 1]; the cell in column c and row r is number `r * columns + c`."""
    grid_lane: Integers
    """[..] lanes, ascending in every cell, whose boxes touch the cell."""


class Movements(NamedTuple):
    """The M movements through the junctions."""

    origin: Integers
    """[M] the ordinary lane that it starts from."""
    exit: Integers
    """[M] the ordinary lane that it leads to."""
    length: Floats
    """[M] m."""
    yields: NDArray[np.bool_]
    """[M] yields to what it conflicts with: a roundabout's entry, a ramp, or as the map's file says."""
    priority: Integers
    """[M] among those that wait: 0 goes first, a higher number yields to a lower one."""
    signal: Integers
    """[M] the group of `Signals` that governs it, or -1."""
    lane_start: Integers
    """[M+1]."""
    lane: Integers
    """[..] its lanes in driving order."""
    conflict_start: Integers
    """[M+1]."""
    conflict: Integers
    """[..] movements of other origins that sweep a common area or lead to the same exit."""
    release: Floats
    """[..] m along the conflict, in the order of `conflict`: vehicles beyond it are out of the way."""
    sibling_start: Integers
    """[M+1]."""
    sibling: Integers
    """[..] movements with the same origin."""
    shared: Floats
    """[..] m from the origin over which the two siblings' swept areas overlap, in the order of `sibling`."""


class Signals(NamedTuple):
    """G groups of traffic lights that change together (none on a map without lights).

    Times are seconds within the group's cycle; the groups of one junction share a cycle.
    """

    cycle: Floats
    """[G] s."""
    green_from: Floats
    """[G] s; the light is green from here on."""
    green_until: Floats
    """[G] s; smaller than `green_from` where the green phase extends over the cycle's end."""
    yellow: Floats
    """[G] s after the green phase; then it is red."""
