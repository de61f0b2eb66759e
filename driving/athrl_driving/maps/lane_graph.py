"""A town's lanes as arrays: what kernels read.

Every lane is one row and exactly a straight line or a circular arc. Junctions are crossed on *movements*: a
movement is the chain of one to three rows that leads from an incoming lane to an outgoing one, and it is
what a vehicle reserves.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

TURN_LEFT, TURN_STRAIGHT, TURN_RIGHT = 0, 1, 2


class LaneGraph(NamedTuple):
    """The lanes, L rows (C-contiguous arrays; numba takes the tuple as it is).

    Lists of variable length are in compressed form: those of row `i` are `values[start[i]:start[i + 1]]`.
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
    """[L] m."""
    speed_limit: Floats
    """[L] m/s."""
    successor_start: Integers
    """[L+1]."""
    successor: Integers
    """[S] rows that follow; every lane has at least one."""
    junction: Integers
    """[L] -1 on ordinary lanes, else the junction's number; each arm of a roundabout is a junction."""
    turn: Integers
    """[L] 0 left, 1 straight, 2 right; 1 on ordinary lanes. A roundabout is entered and left to the right."""
    left: Integers
    """[L] the neighbour in the same direction on the left, or -1."""
    right: Integers
    """[L] the neighbour in the same direction on the right, or -1."""
    conflict_start: Integers
    """[L+1]."""
    conflict: Integers
    """[C] junction lanes of other origins whose swept area meets this one's."""
    start_cos: Floats
    """[L] cosine of `start_heading`."""
    start_sin: Floats
    """[L] sine of `start_heading`."""
    box: Floats
    """[L, 4] least x, least y, greatest x, greatest y of the lane's surface, m."""
    movement: Integers
    """[L] the movement that the row belongs to, -1 on ordinary lanes."""
    movement_offset: Floats
    """[L] m driven on the movement before the row starts; 0 on ordinary lanes."""


class Movements(NamedTuple):
    """The ways through the junctions, M rows."""

    origin: Integers
    """[M] the ordinary lane that it starts from."""
    exit: Integers
    """[M] the ordinary lane that it leads to."""
    length: Floats
    """[M] m."""
    yields: NDArray[np.bool_]
    """[M] gives way to the movements it conflicts with (a roundabout's entries)."""
    lane_start: Integers
    """[M+1]."""
    lane: Integers
    """[..] its rows in driving order."""
    conflict_start: Integers
    """[M+1]."""
    conflict: Integers
    """[..] movements of other origins that sweep a common area or lead to the same exit."""
    release: Floats
    """[..] m along the conflict, in the order of `conflict`: behind them its vehicles are out of the way."""
    sibling_start: Integers
    """[M+1]."""
    sibling: Integers
    """[..] movements with the same origin."""
    shared: Floats
    """[..] m from the origin over which the two siblings' swept areas overlap, in the order of `sibling`."""
