"""The queue of each link: its vehicles as a linked list in driving order, rebuilt in every tick, compiled."""

from athrl_driving.kernels.compilation import part
from athrl_driving.maps.lane_graph import LaneGraph
from athrl_driving.traffic.columns import NONE, Background, LaneChanges, Scratch
from athrl_driving.traffic.lane_links import LaneLinks

OLD_LANE_CLEAR_SHARE = 0.1
"""Share of a lane change's start offset below which the vehicle no longer overlaps the old lane."""


@part
def fill_link_queues(
    graph: LaneGraph, lane_links: LaneLinks, background: Background, changes: LaneChanges, scratch: Scratch
) -> None:
    """Enter vehicles on their links, and on the link beside while they overlap it or request a gap on it."""
    lanes, along, link, place = background.lane, background.s, lane_links.link, lane_links.link_offset
    vehicles = lanes.shape[0]
    scratch.first[:] = NONE
    scratch.last[:] = NONE
    for vehicle in range(vehicles):
        lane = lanes[vehicle]
        insert(scratch, vehicle, link[lane], place[lane] + along[vehicle])
        scratch.link[vehicles + vehicle] = NONE
        changing = changes.distance[vehicle] > 0.0
        if changing or changes.requests_gap[vehicle]:
            overlaps = abs(background.offset[vehicle]) > OLD_LANE_CLEAR_SHARE * abs(
                changes.start_offset[vehicle]
            )
            if overlaps or not changing:
                insert_beside(
                    graph,
                    lane_links,
                    scratch,
                    vehicles + vehicle,
                    lane,
                    along[vehicle],
                    changes.side[vehicle],
                )


@part
def insert_beside(
    graph: LaneGraph, lane_links: LaneLinks, scratch: Scratch, entry: int, lane: int, s: float, side: int
) -> None:
    """Insert an entry on the link beside `lane`, if there is one."""
    other = lane_links.beside[lane, side]
    if other >= 0:
        position = lane_links.link_offset[other] + s * graph.length[other] / graph.length[lane]
        insert(scratch, entry, lane_links.link[other], position)


@part
def insert(scratch: Scratch, entry: int, link: int, position: float) -> None:
    """Insert an entry at its position on a link; of two at the same position the later one is ahead."""
    scratch.link[entry], scratch.position[entry] = link, position
    behind, ahead = scratch.last[link], NONE
    while behind != NONE and scratch.position[behind] > position:
        ahead, behind = behind, scratch.preceding[behind]
    scratch.preceding[entry], scratch.following[entry] = behind, ahead
    if behind == NONE:
        scratch.first[link] = entry
    else:
        scratch.following[behind] = entry
    if ahead == NONE:
        scratch.last[link] = entry
    else:
        scratch.preceding[ahead] = entry


@part
def remove(scratch: Scratch, entry: int) -> None:
    """Remove an entry from its link."""
    link, behind, ahead = scratch.link[entry], scratch.preceding[entry], scratch.following[entry]
    if link == NONE:
        return
    if behind == NONE:
        scratch.first[link] = ahead
    else:
        scratch.following[behind] = ahead
    if ahead == NONE:
        scratch.last[link] = behind
    else:
        scratch.preceding[ahead] = behind
    scratch.link[entry] = NONE


@part
def vehicle_of(entry: int, vehicles: int) -> int:
    """Return the vehicle of an entry."""
    return entry if entry < vehicles else entry - vehicles
