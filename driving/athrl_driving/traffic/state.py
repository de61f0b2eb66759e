"""Makes the traffic's arrays for a batch of environments, and views of one environment."""

import weakref

import numpy as np
from highway_env.vehicle.behavior import IDMVehicle

from athrl_driving.errors import DrivingError
from athrl_driving.kernels.compilation import inlined
from athrl_driving.kernels.environment_views import view_maker
from athrl_driving.maps import Town
from athrl_driving.traffic.columns import (
    NONE,
    PATH_LENGTH,
    Background,
    EgoOnLinks,
    LaneChanges,
    RightOfWay,
    Scratch,
    Traffic,
)
from athrl_driving.traffic.conflict_zones import ConflictZones, conflict_zones_of
from athrl_driving.traffic.lane_links import LaneLinks, build_lane_links

EGO_PATH_LENGTH = 64
"""Links of the ego's path that are considered."""

_LINKS_OF_TOWNS: dict[int, LaneLinks] = {}
_ZONES_OF_TOWNS: dict[int, ConflictZones] = {}

__all__ = [
    "NONE",
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
    lane_links, conflict_zones = _links_of(town)
    if count > starting_places(town):
        raise DrivingError(
            f"vehicles_count is {count}, but the town has room for {starting_places(town)} at most"
        )
    links, movements = len(lane_links.length), len(lane_links.arrival_penalty)
    return Traffic(
        graph=town.graph,
        movements=town.movements,
        signals=town.signals,
        lane_links=lane_links,
        conflict_zones=conflict_zones,
        background=_new_background((environments, count), length, width),
        lane_changes=_new_lane_changes((environments, count)),
        right_of_way=_new_right_of_way(environments, count, links, movements),
        ego_on_links=_new_ego_on_links(environments, links, movements),
        scratch=_new_scratch(environments, count, links),
    )


def starting_places(town: Town) -> int:
    """Return the number of places of a town where background vehicles may start."""
    return len(lane_links_of(town).start_link)


def _links_of(town: Town) -> tuple[LaneLinks, ConflictZones]:
    """Return what is built once a town, and kept for as long as the town is."""
    links = lane_links_of(town)
    if id(town) not in _ZONES_OF_TOWNS:
        _ZONES_OF_TOWNS[id(town)] = conflict_zones_of(town)
        weakref.finalize(town, _ZONES_OF_TOWNS.pop, id(town), None)
    return links, _ZONES_OF_TOWNS[id(town)]


def lane_links_of(town: Town) -> LaneLinks:
    """Return the links of a town, built once.

    Whoever only asks how many vehicles fit needs no conflict zones, the first thing that calls a kernel.
    """
    if id(town) not in _LINKS_OF_TOWNS:
        _LINKS_OF_TOWNS[id(town)] = build_lane_links(town)
        weakref.finalize(town, _LINKS_OF_TOWNS.pop, id(town), None)
    return _LINKS_OF_TOWNS[id(town)]


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
        path=np.full((*shape, PATH_LENGTH), NONE),
        random_state=np.zeros(shape, np.uint64),
    )


def _new_lane_changes(shape: tuple[int, int]) -> LaneChanges:
    return LaneChanges(
        start_offset=np.zeros(shape),
        driven=np.zeros(shape),
        distance=np.zeros(shape),
        side=np.zeros(shape, np.int64),
        requests_gap=np.zeros(shape, np.bool_),
        waiting_since=np.full(shape, np.inf),
        next_decision=np.zeros(shape),
    )


def _new_right_of_way(environments: int, count: int, links: int, movements: int) -> RightOfWay:
    with_ego = (environments, count + 1)
    return RightOfWay(
        crossing=np.full(with_ego, NONE),
        granted=np.full(with_ego, NONE),
        granted_at=np.zeros(with_ego),
        grant_number=np.zeros(with_ego, np.int64),
        crossing_number=np.zeros(with_ego, np.int64),
        ahead=np.full(with_ego, NONE),
        line_distance=np.full(with_ego, np.inf),
        waiting_since=np.full(with_ego, np.inf),
        holders=np.zeros((environments, movements), np.int64),
        rearmost=np.full((environments, movements), np.inf),
        rearmost_speed=np.zeros((environments, movements)),
        inbound=np.zeros((environments, links), np.int64),
        claimed=np.zeros((environments, movements), np.bool_),
        entry=np.full((environments, count), NONE),
    )


def _new_ego_on_links(environments: int, links: int, movements: int) -> EgoOnLinks:
    return EgoOnLinks(
        rear=np.full((environments, links), np.inf),
        front=np.full((environments, links), -np.inf),
        speed=np.zeros((environments, links)),
        blocks=np.zeros((environments, movements), np.int64),
        links=np.zeros((environments, links), np.int64),
        covered=np.zeros((environments, 1), np.int64),
        path_link=np.full((environments, EGO_PATH_LENGTH), NONE),
        path_base=np.zeros((environments, EGO_PATH_LENGTH)),
        path_until=np.zeros((environments, EGO_PATH_LENGTH)),
    )


def _new_scratch(environments: int, count: int, links: int) -> Scratch:
    with_ego, entries = (environments, count + 1), (environments, 2 * count)
    return Scratch(
        first=np.full((environments, links), NONE),
        last=np.full((environments, links), NONE),
        following=np.full(entries, NONE),
        preceding=np.full(entries, NONE),
        link=np.full(entries, NONE),
        position=np.zeros(entries),
        gap=np.full(with_ego, np.inf),
        leader_speed=np.zeros(with_ego),
        side_gap=np.full((environments, count), np.inf),
        side_speed=np.zeros((environments, count)),
        held_up=np.zeros(with_ego, np.bool_),
        order=np.zeros(with_ego, np.int64),
        grants=np.zeros((environments, 1), np.int64),
        clock=np.zeros((environments, 1)),
    )


def environment_views(traffic: Traffic, e: int) -> Traffic:
    """Return the same as `environment_traffic`, for Python."""
    parts = {name: getattr(traffic, name) for name in _OF_ENVIRONMENTS}
    views = {name: type(part)(*(column[e] for column in part)) for name, part in parts.items()}
    return traffic._replace(**views)


_OF_ENVIRONMENTS = ("background", "lane_changes", "right_of_way", "ego_on_links", "scratch")
_background_view = view_maker(Background)
_lane_changes_view = view_maker(LaneChanges)
_right_of_way_view = view_maker(RightOfWay)
_ego_view = view_maker(EgoOnLinks)
_scratch_view = view_maker(Scratch)


@inlined
def environment_traffic(traffic: Traffic, e: int) -> Traffic:
    """Return the view of environment `e`: the same memory without the environment axis."""
    return Traffic(
        traffic.graph,
        traffic.movements,
        traffic.signals,
        traffic.lane_links,
        traffic.conflict_zones,
        _background_view(traffic.background, e),
        _lane_changes_view(traffic.lane_changes, e),
        _right_of_way_view(traffic.right_of_way, e),
        _ego_view(traffic.ego_on_links, e),
        _scratch_view(traffic.scratch, e),
    )
