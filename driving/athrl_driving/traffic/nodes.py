"""Who is where on which link: a list for each link in driving order, made anew in every tick."""

from athrl_driving.compilation import part
from athrl_driving.maps.lane_graph import LaneGraph
from athrl_driving.traffic.columns import NOBODY, Background, LaneChanges, Scratch
from athrl_driving.traffic.rails import Rails

LEFT_BEHIND = 0.1
"""Share of a lane change's way sideways from whose rest on the lane left behind is free of the vehicle."""


@part
def sort_onto_links(
    graph: LaneGraph, rails: Rails, background: Background, changes: LaneChanges, scratch: Scratch
) -> None:
    """List everybody on its link, and on the link beside while it overlaps that or asks to be let in."""
    lanes, along, link, place = background.lane, background.s, rails.link, rails.link_offset
    vehicles = lanes.shape[0]
    scratch.first[:] = NOBODY
    scratch.last[:] = NOBODY
    for row in range(vehicles):
        lane = lanes[row]
        insert(scratch, row, link[lane], place[lane] + along[row])
        scratch.link[vehicles + row] = NOBODY
        changing = changes.over[row] > 0.0
        if changing or changes.asks[row]:
            overlaps = abs(background.offset[row]) > LEFT_BEHIND * abs(changes.start_offset[row])
            if overlaps or not changing:
                insert_beside(graph, rails, scratch, vehicles + row, lane, along[row], changes.side[row])


@part
def insert_beside(
    graph: LaneGraph, rails: Rails, scratch: Scratch, node: int, lane: int, s: float, side: int
) -> None:
    """Put a node on the link beside `lane`, where that goes on."""
    other = rails.beside[lane, side]
    if other >= 0:
        position = rails.link_offset[other] + s * graph.length[other] / graph.length[lane]
        insert(scratch, node, rails.link[other], position)


@part
def insert(scratch: Scratch, node: int, link: int, position: float) -> None:
    """Put a node in its place on a link; of two at the same place the later one goes ahead."""
    scratch.link[node], scratch.position[node] = link, position
    behind, ahead = scratch.last[link], NOBODY
    while behind != NOBODY and scratch.position[behind] > position:
        ahead, behind = behind, scratch.preceding[behind]
    scratch.preceding[node], scratch.following[node] = behind, ahead
    if behind == NOBODY:
        scratch.first[link] = node
    else:
        scratch.following[behind] = node
    if ahead == NOBODY:
        scratch.last[link] = node
    else:
        scratch.preceding[ahead] = node


@part
def remove(scratch: Scratch, node: int) -> None:
    """Take a node off its link."""
    link, behind, ahead = scratch.link[node], scratch.preceding[node], scratch.following[node]
    if link == NOBODY:
        return
    if behind == NOBODY:
        scratch.first[link] = ahead
    else:
        scratch.following[behind] = ahead
    if ahead == NOBODY:
        scratch.last[link] = behind
    else:
        scratch.preceding[ahead] = behind
    scratch.link[node] = NOBODY


@part
def owner(node: int, vehicles: int) -> int:
    """Return the vehicle that a node stands for."""
    return node if node < vehicles else node - vehicles
