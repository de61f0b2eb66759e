"""What happens at the edge of an open map: vehicles leave it, and enter it again elsewhere, compiled.

The number of vehicles stays: one that leaves is put on an entry, a link on which a road enters the map, and
drives on from there as another vehicle would. So the edge is like a stop line. A vehicle that comes near it
reserves an entry that is free, drawn with its own random numbers; while there is none, it waits at the edge.
Nobody else enters on a reserved entry, and nobody changes lanes to its beginning. A vehicle leaves when its
centre has reached the edge, and enters with its rear on it.
"""

import math

from athrl_driving.kernels.compilation import part
from athrl_driving.kernels.random_numbers import random_below
from athrl_driving.maps.lane_graph import Floats
from athrl_driving.maps.levels import VEHICLE_LEVEL_HEIGHT
from athrl_driving.traffic.collision import rectangles_touch
from athrl_driving.traffic.columns import NONE, Traffic
from athrl_driving.traffic.ego_columns import ELEVATION, HEADING, LENGTH, PRESENT, WIDTH, X, Y
from athrl_driving.traffic.geometry import lane_elevation, lane_pose
from athrl_driving.traffic.idm import LARGEST_ACCELERATION
from athrl_driving.traffic.lane_links import CURVE_BRAKING
from athrl_driving.traffic.leaders import look_ahead, stopping_speed
from athrl_driving.traffic.link_queues import insert, remove, vehicle_of
from athrl_driving.traffic.paths import plan_from, put_on_link

ENTRY_GAP = 3.0
"""Metres from an entering vehicle's front to the next one's rear, even if that brakes hard, at least."""

EGO_GAP = 10.0
"""Metres from an entering vehicle's front to the ego, at least."""

RESERVE_MARGIN = 2.0
"""Metres before the point where a vehicle would have to brake for the edge at which it reserves an entry."""

_ORDERS_A_SECOND = 10.0
"""How often another vehicle is the first that may reserve an entry."""

_DECIDED_MARGIN = 1.0
_AT_EDGE = 1e-3
_ROOM_AROUND = 0.3


@part
def cross_edge(traffic: Traffic, ego: Floats) -> None:
    """Let vehicles near the edge reserve entries, and put those that have reached it on theirs."""
    background, lane_links, scratch = traffic.background, traffic.lane_links, traffic.scratch
    reserved, vehicles = traffic.right_of_way.entry, background.lane.shape[0]
    # Where entries are rare, those at one edge would wait for ever behind others if the order stayed.
    first = int(_ORDERS_A_SECOND * scratch.clock[0])
    for turn in range(vehicles):
        vehicle = (first + turn) % vehicles
        link = scratch.link[vehicle]
        if not lane_links.leaves[link]:
            reserved[vehicle] = NONE
            continue
        speed, rest = background.speed[vehicle], lane_links.length[link] - scratch.position[vehicle]
        to_edge = rest - 0.5 * background.length[vehicle]
        braking = speed * speed / (2.0 * CURVE_BRAKING)
        if to_edge > braking + RESERVE_MARGIN:
            reserved[vehicle] = NONE
            continue
        entry = reserved[vehicle]
        # A reservation holds once the vehicle cannot stop any more, until it enters.
        may_stop = to_edge > braking + _DECIDED_MARGIN
        at_edge = rest <= _AT_EDGE
        if entry == NONE or ((may_stop or at_edge) and not _is_free(traffic, ego, vehicle, entry)):
            entry = reserved[vehicle] = _free_entry(traffic, ego, vehicle)
        if at_edge and entry != NONE:
            _enter(traffic, vehicle, lane_links.entries[entry])
        elif at_edge:
            background.speed[vehicle] = 0.0


@part
def _free_entry(traffic: Traffic, ego: Floats, vehicle: int) -> int:
    """Return a free entry, searched from one drawn at random; -1 if there is none."""
    count = traffic.lane_links.entries.shape[0]
    first = random_below(traffic.background.random_state[vehicle : vehicle + 1], count)
    for step in range(count):
        entry = (first + step) % count
        if _is_free(traffic, ego, vehicle, entry):
            return entry
    return NONE


@part
def _is_free(traffic: Traffic, ego: Floats, vehicle: int, entry: int) -> bool:
    """Tell whether a vehicle can enter: no other has reserved the entry, and nobody is on its beginning."""
    background, scratch, reserved = traffic.background, traffic.scratch, traffic.right_of_way.entry
    vehicles, link = background.lane.shape[0], traffic.lane_links.entries[entry]
    for other in range(vehicles):
        if reserved[other] == entry and other != vehicle:
            return False
    if traffic.ego_on_links.rear[link] < background.length[vehicle] + EGO_GAP:
        return False
    ahead = scratch.first[link]
    leader = vehicle if ahead == NONE else vehicle_of(ahead, vehicles)
    # The vehicle itself may be on this link, at its other end.
    if leader != vehicle:
        speed = background.speed[leader]
        stop = scratch.position[ahead] + speed * speed / (2.0 * LARGEST_ACCELERATION)
        if stop - 0.5 * background.length[leader] < background.length[vehicle] + ENTRY_GAP:
            return False
    return _is_clear(traffic, ego, vehicle, link)


@part
def _is_clear(traffic: Traffic, ego: Floats, vehicle: int, link: int) -> bool:
    """Tell whether no body is where a vehicle would enter, on whatever lane: lanes may lie on each other."""
    background, graph, lane_links = traffic.background, traffic.graph, traffic.lane_links
    length, width = background.length[vehicle], background.width[vehicle] + _ROOM_AROUND
    lane = lane_links.lanes[lane_links.lane_start[link]]
    x, y, heading = lane_pose(graph, lane, 0.5 * length)
    elevation = lane_elevation(graph, lane, 0.5 * length)
    length += 2.0 * _ROOM_AROUND
    if (
        ego[PRESENT] > 0.0
        and abs(ego[ELEVATION] - elevation) <= VEHICLE_LEVEL_HEIGHT
        and rectangles_touch(
            x, y, heading, length, width, ego[X], ego[Y], ego[HEADING], ego[LENGTH], ego[WIDTH]
        )
    ):
        return False
    for other in range(background.lane.shape[0]):
        if (
            other != vehicle
            and abs(background.elevation[other] - elevation) <= VEHICLE_LEVEL_HEIGHT
            and rectangles_touch(
                x, y, heading, length, width,
                background.x[other], background.y[other], background.heading[other],
                background.length[other], background.width[other],
            )
        ):  # fmt: skip
            return False
    return True


@part
def _enter(traffic: Traffic, vehicle: int, link: int) -> None:
    """Put a vehicle on the beginning of a link, as fast as it may drive there."""
    background, changes, scratch = traffic.background, traffic.lane_changes, traffic.scratch
    lane_links, right_of_way = traffic.lane_links, traffic.right_of_way
    remove(scratch, vehicle)
    remove(scratch, background.lane.shape[0] + vehicle)
    put_on_link(traffic, vehicle, link, 0.5 * background.length[vehicle])
    plan_from(lane_links, background, vehicle, 1)
    insert(scratch, vehicle, link, 0.5 * background.length[vehicle])
    background.offset[vehicle] = background.acceleration[vehicle] = changes.distance[vehicle] = 0.0
    changes.requests_gap[vehicle] = False
    changes.waiting_since[vehicle] = right_of_way.waiting_since[vehicle] = math.inf
    right_of_way.crossing[vehicle] = right_of_way.granted[vehicle] = right_of_way.entry[vehicle] = NONE
    look_ahead(traffic, vehicle, background.length[vehicle], 0.0)
    pace = min(background.desired_speed[vehicle], lane_links.entry_speed[background.lane[vehicle]])
    background.speed[vehicle] = min(pace, stopping_speed(traffic, vehicle))
