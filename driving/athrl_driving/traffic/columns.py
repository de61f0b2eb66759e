"""The traffic of E environments as a structure of arrays, which the kernels read and write.

Every array of `Background`, `LaneChanges`, `RightOfWay`, `EgoOnLinks` and `Scratch` has a leading environment
axis, which the shapes below leave out: kernels work on the view of one environment, from
`state.environment_traffic`. N is the number of background vehicles of an environment, L that of lanes of the
lane graph, K that of lane links, M that of movements.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph, Movements, Signals
from athrl_driving.traffic.conflict_zones import ConflictZones
from athrl_driving.traffic.lane_links import LaneLinks

PATH_LENGTH = 12
"""Links that a vehicle plans ahead, its own first: more than the look-ahead reaches."""

NONE = -1
"""No vehicle, link, movement, side or queue entry."""


class Background(NamedTuple):
    """The background vehicles."""

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
    """[N] lane of the lane graph."""
    s: Floats
    """[N] m along the lane."""
    offset: Floats
    """[N] m beside the lane's centre line, positive to the right; not 0 while the vehicle changes lanes."""
    acceleration: Floats
    """[N] m/s2, of the last tick."""
    desired_speed: Floats
    """[N] m/s on a free road."""
    crashed: NDArray[np.bool_]
    """[N] the ego has hit it."""
    path: Integers
    """[N, PATH_LENGTH] the links ahead, the present one first; -1 after a link that ends."""
    random_state: NDArray[np.uint64]
    """[N] each vehicle's own random numbers, so that its turns do not depend on the order of the vehicles."""


class LaneChanges(NamedTuple):
    """Lane changes under way and requested. A changing vehicle counts as on the new lane from the start."""

    start_offset: Floats
    """[N] m, the offset when the change began."""
    driven: Floats
    """[N] m since the change began."""
    distance: Floats
    """[N] m that the change takes; 0 while the vehicle is not changing."""
    side: Integers
    """[N] the side of the old lane, or of the lane to change to: 0 left, 1 right."""
    requests_gap: NDArray[np.bool_]
    """[N] it stands where its lane ends and requests a gap from the vehicles on `side`."""
    waiting_since: Floats
    """[N] s since when it waits there; infinite while it does not."""
    next_decision: Floats
    """[N] s when it next decides about a lane change."""


class RightOfWay(NamedTuple):
    """Which vehicle may cross which junction. 0..N-1 are the background vehicles, N is the ego."""

    crossing: Integers
    """[N+1] the movement that the vehicle is on, until its rear has left it; -1 none."""
    granted: Integers
    """[N+1] the movement ahead that has been granted to it; -1 none."""
    granted_at: Floats
    """[N+1] s."""
    grant_number: Integers
    """[N+1] the number of the grant in `granted`; no vehicle waits for one with a greater number."""
    crossing_number: Integers
    """[N+1] the number of the grant with which it crosses."""
    ahead: Integers
    """[N+1] the next movement on its path; -1 where none is near."""
    line_distance: Floats
    """[N+1] m from its front to the stop line of `ahead`; infinite where none is near."""
    waiting_since: Floats
    """[N+1] s since when it requests `ahead`; infinite while it does not."""
    holders: Integers
    """[M] how many vehicles hold or cross the movement."""
    rearmost: Floats
    """[M] m along the movement to the rear of its last vehicle; minus infinity before that has entered."""
    rearmost_speed: Floats
    """[M] m/s of its last vehicle."""
    inbound: Integers
    """[K] how many vehicles hold a movement to this link and have not arrived on it."""
    claimed: NDArray[np.bool_]
    """[M] a vehicle earlier in `order` has claimed it: no conflicting movement is granted after that."""
    entry: Integers
    """[N] the place in `LaneLinks.entries` where a vehicle that leaves the map will enter again; -1 none."""


class EgoOnLinks(NamedTuple):
    """The ego as an obstacle: the part of every link that its body covers."""

    rear: Floats
    """[K] m along the link to the nearest point of the body on it; infinite where there is none."""
    front: Floats
    """[K] m to the farthest point."""
    speed: Floats
    """[K] m/s along the link."""
    blocks: Integers
    """[M] 0 it is not on the movement, 1 it covers a part of it, 2 it drives along it."""
    links: Integers
    """[K] the covered links."""
    covered: Integers
    """[1] the number of covered links."""
    path_link: Integers
    """[P] the links on its path."""
    path_base: Floats
    """[P] m from its centre to the start of each."""
    path_until: Floats
    """[P] m along each to where it leaves it."""


class Scratch(NamedTuple):
    """Space for what every tick computes, and the clock.

    Each link has a queue: a linked list of entries in driving order. Entry i is vehicle i on its link. Entry
    N+i is the same vehicle on the link beside, which it has not left yet or on which it requests a gap.
    """

    first: Integers
    """[K] the rearmost entry in the link's queue, or -1."""
    last: Integers
    """[K] the foremost entry."""
    following: Integers
    """[2N] the entry ahead in the same queue, or -1."""
    preceding: Integers
    """[2N] the entry behind."""
    link: Integers
    """[2N] the entry's link; -1 while it is in no queue."""
    position: Floats
    """[2N] m along the link."""
    gap: Floats
    """[N+1] m from bumper to bumper to the leader; infinite without one."""
    leader_speed: Floats
    """[N+1] m/s along the path."""
    side_gap: Floats
    """[N] m to the leader on the lane that a changing vehicle has not left yet."""
    side_speed: Floats
    """[N] m/s of that leader."""
    held_up: NDArray[np.bool_]
    """[N+1] the leader is before the stop line and has no grant to cross."""
    order: Integers
    """[N+1] the vehicles that request a movement, in the order in which requests are handled."""
    grants: Integers
    """[1] how many grants there have been in the episode."""
    clock: Floats
    """[1] s; it starts at a random time of the signals' cycle."""


class Traffic(NamedTuple):
    """Everything that a tick needs."""

    graph: LaneGraph
    movements: Movements
    signals: Signals
    lane_links: LaneLinks
    conflict_zones: ConflictZones
    background: Background
    lane_changes: LaneChanges
    right_of_way: RightOfWay
    ego_on_links: EgoOnLinks
    scratch: Scratch
