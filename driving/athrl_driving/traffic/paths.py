"""Puts background vehicles on links, and draws their paths: random turns by their own numbers, compiled."""

from athrl_driving.kernels.compilation import part
from athrl_driving.kernels.random_numbers import random_below
from athrl_driving.traffic.columns import NONE, PATH_LENGTH, Background, Traffic
from athrl_driving.traffic.geometry import lane_elevation, lane_pose
from athrl_driving.traffic.lane_links import LaneLinks


@part
def put_on_link(traffic: Traffic, vehicle: int, link: int, position: float) -> None:
    """Put a vehicle `position` metres along a link, the first of its path."""
    background, lane_links, graph = traffic.background, traffic.lane_links, traffic.graph
    index = lane_links.lane_start[link]
    lane = lane_links.lanes[index]
    while (
        position > lane_links.link_offset[lane] + graph.length[lane]
        and index + 1 < lane_links.lane_start[link + 1]
    ):
        index += 1
        lane = lane_links.lanes[index]
    s = position - lane_links.link_offset[lane]
    background.lane[vehicle], background.s[vehicle], background.path[vehicle, 0] = lane, s, link
    background.x[vehicle], background.y[vehicle], background.heading[vehicle] = lane_pose(graph, lane, s)
    background.elevation[vehicle] = lane_elevation(graph, lane, s)


@part
def plan_from(lane_links: LaneLinks, background: Background, vehicle: int, first: int) -> None:
    """Draw a new path for a vehicle from place `first` on; the places before stay."""
    path = background.path
    link = path[vehicle, first - 1]
    for place in range(first, PATH_LENGTH):
        if link != NONE:
            start = lane_links.next_start[link]
            count = lane_links.next_start[link + 1] - start
            if count == 0:
                link = NONE
            elif count == 1:
                link = lane_links.next[start]
            else:
                link = lane_links.next[
                    start + random_below(background.random_state[vehicle : vehicle + 1], count)
                ]
        path[vehicle, place] = link


@part
def drop_first(lane_links: LaneLinks, background: Background, vehicle: int) -> None:
    """Drop the first link of the path and append one at its end."""
    path = background.path
    for place in range(PATH_LENGTH - 1):
        path[vehicle, place] = path[vehicle, place + 1]
    plan_from(lane_links, background, vehicle, PATH_LENGTH - 1)
