"""The traffic's arrays: made for a batch of environments, and seen as one environment's."""

import numpy as np
from highway_env.vehicle.behavior import IDMVehicle

from athrl_driving.compilation import inlined
from athrl_driving.errors import DrivingError
from athrl_driving.maps import Town
from athrl_driving.traffic.columns import (
    EGO_FIELDS,
    NOBODY,
    PATH_LENGTH,
    Background,
    EgoOnLinks,
    LaneChanges,
    RightOfWay,
    Scratch,
    Traffic,
)
from athrl_driving.traffic.meetings import Meetings, meetings_of
from athrl_driving.traffic.rails import Rails, lay_rails

EGO_PATH_LENGTH = 64
"""Links of the ego's path that are looked at."""

_RAILS: dict[int, tuple[Town, Rails, Meetings]] = {}

__all__ = [
    "EGO_FIELDS",
    "NOBODY",
    "Background",
    "Traffic",
    "environment_traffic",
    "environment_views",
    "new_traffic",
]


def new_traffic(
    town: Town,
    environments: int,
    count: int,
    length: float = float(IDMVehicle.LENGTH),
    width: float = float(IDMVehicle.WIDTH),
) -> Traffic:
    """Return arrays for `count` vehicles (m long and wide) in each environment, not placed yet.

    Raises `DrivingError` for a negative count and for more than there are places to start at.
    """
    if count < 0:
        raise DrivingError(f"vehicles_count is {count}, but it must be 0 or more")
    rails, meetings = _rails_of(town)
    if count > starting_places(town):
        raise DrivingError(
            f"vehicles_count is {count}, but the town has room for {starting_places(town)} at most"
        )
    links, ways = len(rails.length), len(rails.later)
    return Traffic(
        graph=town.graph,
        movements=town.movements,
        signals=town.signals,
        rails=rails,
        meetings=meetings,
        background=_new_background((environments, count), length, width),
        lane_changes=_new_lane_changes((environments, count)),
        right_of_way=_new_right_of_way(environments, count, links, ways),
        ego_on_links=_new_ego_on_links(environments, links, ways),
        scratch=_new_scratch(environments, count, links),
    )


def starting_places(town: Town) -> int:
    """Return at how many places of a town background vehicles may start."""
    rails, _ = _rails_of(town)
    return len(rails.start_link)


def _rails_of(town: Town) -> tuple[Rails, Meetings]:
    """Return what is made once a town; the town is kept with it, so that its id stays its own."""
    if id(town) not in _RAILS:
        _RAILS[id(town)] = town, lay_rails(town), meetings_of(town)
    return _RAILS[id(town)][1:]


def _new_background(shape: tuple[int, int], length: float, width: float) -> Background:
    return Background(
        x=np.zeros(shape),
        y=np.zeros(shape),
        heading=np.zeros(shape),
        elevation=np.zeros(shape),
        speed=np.zeros(shape),
        length=np.full(shape, length),
        width=np.full(shape, width),
        lane=np.zeros(shape, np.int64),
        s=np.zeros(shape),
        offset=np.zeros(shape),
        acceleration=np.zeros(shape),
        desired_speed=np.zeros(shape),
        crashed=np.zeros(shape, np.bool_),
        path=np.full((*shape, PATH_LENGTH), NOBODY),
        random_state=np.zeros(shape, np.uint64),
    )


def _new_lane_changes(shape: tuple[int, int]) -> LaneChanges:
    return LaneChanges(
        start_offset=np.zeros(shape),
        driven=np.zeros(shape),
        over=np.zeros(shape),
        side=np.zeros(shape, np.int64),
        asks=np.zeros(shape, np.bool_),
        wanted_since=np.full(shape, np.inf),
        next_thought=np.zeros(shape),
    )


def _new_right_of_way(environments: int, count: int, links: int, ways: int) -> RightOfWay:
    rows = (environments, count + 1)
    return RightOfWay(
        crossing=np.full(rows, NOBODY),
        granted=np.full(rows, NOBODY),
        granted_at=np.zeros(rows),
        turn=np.zeros(rows, np.int64),
        crossing_turn=np.zeros(rows, np.int64),
        ahead=np.full(rows, NOBODY),
        line_distance=np.full(rows, np.inf),
        waiting_since=np.full(rows, np.inf),
        holders=np.zeros((environments, ways), np.int64),
        rearmost=np.full((environments, ways), np.inf),
        rearmost_speed=np.zeros((environments, ways)),
        inbound=np.zeros((environments, links), np.int64),
        claimed=np.zeros((environments, ways), np.bool_),
    )


def _new_ego_on_links(environments: int, links: int, ways: int) -> EgoOnLinks:
    return EgoOnLinks(
        rear=np.full((environments, links), np.inf),
        front=np.full((environments, links), -np.inf),
        speed=np.zeros((environments, links)),
        blocks=np.zeros((environments, ways), np.int64),
        links=np.zeros((environments, links), np.int64),
        covered=np.zeros((environments, 1), np.int64),
        path_link=np.full((environments, EGO_PATH_LENGTH), NOBODY),
        path_base=np.zeros((environments, EGO_PATH_LENGTH)),
        path_until=np.zeros((environments, EGO_PATH_LENGTH)),
    )


def _new_scratch(environments: int, count: int, links: int) -> Scratch:
    rows, nodes = (environments, count + 1), (environments, 2 * count)
    return Scratch(
        first=np.full((environments, links), NOBODY),
        last=np.full((environments, links), NOBODY),
        following=np.full(nodes, NOBODY),
        preceding=np.full(nodes, NOBODY),
        link=np.full(nodes, NOBODY),
        position=np.zeros(nodes),
        gap=np.full(rows, np.inf),
        leader_speed=np.zeros(rows),
        side_gap=np.full((environments, count), np.inf),
        side_speed=np.zeros((environments, count)),
        held_up=np.zeros(rows, np.bool_),
        order=np.zeros(rows, np.int64),
        turns=np.zeros((environments, 1), np.int64),
        clock=np.zeros((environments, 1)),
    )


def environment_views(traffic: Traffic, e: int) -> Traffic:
    """Return the same as `environment_traffic`, for Python."""
    return traffic._replace(
        background=Background(*(column[e] for column in traffic.background)),
        lane_changes=LaneChanges(*(column[e] for column in traffic.lane_changes)),
        right_of_way=RightOfWay(*(column[e] for column in traffic.right_of_way)),
        ego_on_links=EgoOnLinks(*(column[e] for column in traffic.ego_on_links)),
        scratch=Scratch(*(column[e] for column in traffic.scratch)),
    )


@inlined
def environment_traffic(traffic: Traffic, e: int) -> Traffic:
    """Return the view of environment `e`: the same memory without the environment axis."""
    background, changes, right_of_way = traffic.background, traffic.lane_changes, traffic.right_of_way
    covered, scratch = traffic.ego_on_links, traffic.scratch
    return Traffic(
        traffic.graph,
        traffic.movements,
        traffic.signals,
        traffic.rails,
        traffic.meetings,
        Background(
            background.x[e],
            background.y[e],
            background.heading[e],
            background.elevation[e],
            background.speed[e],
            background.length[e],
            background.width[e],
            background.lane[e],
            background.s[e],
            background.offset[e],
            background.acceleration[e],
            background.desired_speed[e],
            background.crashed[e],
            background.path[e],
            background.random_state[e],
        ),
        LaneChanges(
            changes.start_offset[e],
            changes.driven[e],
            changes.over[e],
            changes.side[e],
            changes.asks[e],
            changes.wanted_since[e],
            changes.next_thought[e],
        ),
        RightOfWay(
            right_of_way.crossing[e],
            right_of_way.granted[e],
            right_of_way.granted_at[e],
            right_of_way.turn[e],
            right_of_way.crossing_turn[e],
            right_of_way.ahead[e],
            right_of_way.line_distance[e],
            right_of_way.waiting_since[e],
            right_of_way.holders[e],
            right_of_way.rearmost[e],
            right_of_way.rearmost_speed[e],
            right_of_way.inbound[e],
            right_of_way.claimed[e],
        ),
        EgoOnLinks(
            covered.rear[e],
            covered.front[e],
            covered.speed[e],
            covered.blocks[e],
            covered.links[e],
            covered.covered[e],
            covered.path_link[e],
            covered.path_base[e],
            covered.path_until[e],
        ),
        Scratch(
            scratch.first[e],
            scratch.last[e],
            scratch.following[e],
            scratch.preceding[e],
            scratch.link[e],
            scratch.position[e],
            scratch.gap[e],
            scratch.leader_speed[e],
            scratch.side_gap[e],
            scratch.side_speed[e],
            scratch.held_up[e],
            scratch.order[e],
            scratch.turns[e],
            scratch.clock[e],
        ),
    )
