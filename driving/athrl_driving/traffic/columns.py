"""The traffic of E environments as a structure of arrays: what the kernels read and write, column by column.

Every array of `Background`, `LaneChanges`, `RightOfWay`, `EgoOnLinks` and `Scratch` has a leading environment
axis, which the shapes below leave out: `state.environment_traffic` gives one environment's view, what kernels
work on. N is the background vehicles of an environment, L the rows of the lane graph, K the links of `Rails`,
M the movements.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph, Movements, Signals
from athrl_driving.traffic.meetings import Meetings
from athrl_driving.traffic.rails import Rails

PATH_LENGTH = 12
"""Links that a vehicle plans ahead, its own first: more than the look-ahead reaches."""

EGO_FIELDS = 8
"""The ego is float64 [8]: x, y m, heading rad, speed m/s, length, width, elevation m, present (1 or 0)."""

NOBODY = -1


class Background(NamedTuple):
    """The background vehicles; a row is a vehicle."""

    x: Floats
    """[N] m, the centre."""
    y: Floats
    """[N] m."""
    heading: Floats
    """[N] rad."""
    elevation: Floats
    """[N] m."""
    speed: Floats
    """[N] m/s."""
    length: Floats
    """[N] m."""
    width: Floats
    """[N] m."""
    lane: Integers
    """[N] row of the lane graph."""
    s: Floats
    """[N] m along the lane."""
    offset: Floats
    """[N] m beside the lane's centre line, positive to the right; not 0 while it changes lanes."""
    acceleration: Floats
    """[N] m/s2, of the last tick."""
    desired_speed: Floats
    """[N] m/s on a free road."""
    crashed: NDArray[np.bool_]
    """[N] hit by the ego."""
    path: Integers
    """[N, PATH_LENGTH] the links ahead, the present one first; -1 after a link that ends."""
    random_state: NDArray[np.uint64]
    """[N] each vehicle's own random numbers, so that its turns do not depend on the order of the others."""


class LaneChanges(NamedTuple):
    """Who is between two lanes, and who wants to. Who changes is on the new lane from the start."""

    start_offset: Floats
    """[N] m, the offset when it began."""
    driven: Floats
    """[N] m since it began."""
    over: Floats
    """[N] m after which it is over; 0 while the vehicle is not changing."""
    side: Integers
    """[N] where the lane is that it comes from or wants to change to: 0 left, 1 right."""
    asks: NDArray[np.bool_]
    """[N] it stands where its lane ends and asks those on `side` to let it in."""
    wanted_since: Floats
    """[N] s since when it waits there; infinite while it does not."""
    next_thought: Floats
    """[N] s when it thinks of changing again."""


class RightOfWay(NamedTuple):
    """Who may cross which junction. Rows 0..N-1 are the background vehicles, row N is the ego."""

    crossing: Integers
    """[N+1] the movement that the vehicle is on, until its rear has left it; -1 none."""
    granted: Integers
    """[N+1] the movement ahead that it holds; -1 none."""
    granted_at: Floats
    """[N+1] s."""
    turn: Integers
    """[N+1] the number of the right in `granted`; who has a smaller one waits for nobody with a greater."""
    crossing_turn: Integers
    """[N+1] the number of the right with which it crosses."""
    ahead: Integers
    """[N+1] the next movement on its path; -1 where none is near."""
    line_distance: Floats
    """[N+1] m from its front to the stop line of `ahead`; infinite where none is near."""
    waiting_since: Floats
    """[N+1] s since when it asks for `ahead`; infinite while it does not ask."""
    holders: Integers
    """[M] vehicles that hold or cross a movement."""
    rearmost: Floats
    """[M] m along the movement to the rear of its last vehicle; minus infinity before that enters."""
    rearmost_speed: Floats
    """[M] m/s of its last vehicle."""
    inbound: Integers
    """[K] vehicles that hold a movement to this link and have not arrived on it."""
    claimed: NDArray[np.bool_]
    """[M] somebody who waits longer than the present one wants this movement."""


class EgoOnLinks(NamedTuple):
    """The ego as an obstacle: what its body covers of every link."""

    rear: Floats
    """[K] m along the link to the nearest point of the body on it; infinite where there is none."""
    front: Floats
    """[K] m to the farthest point."""
    speed: Floats
    """[K] m/s along the link."""
    blocks: Integers
    """[M] 0 not on the movement, 1 it covers a part of it, 2 it drives along it."""
    links: Integers
    """[K] the covered links."""
    covered: Integers
    """[1] how many they are."""
    path_link: Integers
    """[P] the links that it will drive and"""
    path_base: Floats
    """[P] m from its centre to their start, and"""
    path_until: Floats
    """[P] m along them where it leaves them."""


class Scratch(NamedTuple):
    """Room for what is computed anew in every tick, and the clock.

    Who is on a link is a list in driving order of nodes: node i is vehicle i on its link, node N+i the same
    vehicle on the link beside, which it has not left yet or asks to be let in to.
    """

    first: Integers
    """[K] the rearmost node on the link, or -1."""
    last: Integers
    """[K] the foremost node."""
    following: Integers
    """[2N] the node ahead on the same link, or -1."""
    preceding: Integers
    """[2N] the node behind."""
    link: Integers
    """[2N] the node's link; -1 while it is on none."""
    position: Floats
    """[2N] m along the link."""
    gap: Floats
    """[N+1] m from bumper to bumper to the leader; infinite without one."""
    leader_speed: Floats
    """[N+1] m/s along the path."""
    side_gap: Floats
    """[N] m to the leader on the lane that a changing vehicle has not left yet."""
    side_speed: Floats
    """[N] m/s of that one."""
    held_up: NDArray[np.bool_]
    """[N+1] the leader is before the stop line and holds no right to cross."""
    order: Integers
    """[N+1] the vehicles that ask for a movement, who is served first in front."""
    turns: Integers
    """[1] how many rights have been granted."""
    clock: Floats
    """[1] s; it starts anywhere in the signals' cycle."""


class Traffic(NamedTuple):
    """Everything that a tick needs."""

    graph: LaneGraph
    movements: Movements
    signals: Signals
    rails: Rails
    meetings: Meetings
    background: Background
    lane_changes: LaneChanges
    right_of_way: RightOfWay
    ego_on_links: EgoOnLinks
    scratch: Scratch
