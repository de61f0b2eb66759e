"""Lane changes: when a vehicle changes to the lane beside, and how it moves there.

A vehicle changes lanes where its own lane ends (mandatory), where it can drive better at little cost to the
vehicle behind (MOBIL), and now and then at random, so that every lane of a ring is used. It takes a gap only
where the vehicle behind has to brake gently at most, no vehicle is leaving a junction towards the gap, and
the ego is not near. Where a lane ends, the vehicle waits for a gap; after `REQUEST_AFTER` the vehicles beside
that can stop easily let it in, one at a time.
"""

import math

from athrl_driving.kernels.compilation import part
from athrl_driving.kernels.random_numbers import random_below
from athrl_driving.maps.lane_graph import Floats
from athrl_driving.traffic.columns import NONE, Traffic
from athrl_driving.traffic.ego_columns import PRESENT, SPEED, X, Y
from athrl_driving.traffic.geometry import lane_project
from athrl_driving.traffic.link_queues import insert, insert_beside, remove
from athrl_driving.traffic.mobil import gain_of_change
from athrl_driving.traffic.paths import plan_from

CHANGE_TIME = 3.0
"""Seconds that a change takes, within the least and the greatest distance."""

SHORTEST_CHANGE, LONGEST_CHANGE = 12.0, 25.0
"""Metres."""

REQUEST_AFTER = 3.0
"""Seconds of standing where a lane ends after which a vehicle requests a gap."""

LEAST_GAIN = 0.3
"""m/s2 of acceleration that a discretionary change must gain."""

RANDOM_CHANGE_CHANCE = 15
"""Chance in a thousand, at each decision, of a random change that costs no vehicle anything."""

DECISION_INTERVAL = 1.0
"""Seconds between decisions; a third of that where the lane ends."""

PAUSE_AFTER_CHANGE = 6.0
"""Seconds from the start of a change to the next decision."""

NO_CHANGE_BEFORE_END = 40.0
"""Metres before a link's end where only mandatory changes begin."""

EGO_CLEARANCE = 15.0
"""Metres from the ego, plus those that it drives in a second, within which no vehicle begins a change."""

_END_CLEARANCE = 8.0


@part
def change_lanes(traffic: Traffic, ego: Floats) -> None:
    """Let every vehicle whose decision is due decide about a lane change, and begin it."""
    background, changes, graph = traffic.background, traffic.lane_changes, traffic.graph
    now = traffic.scratch.clock[0]
    for vehicle in range(background.lane.shape[0]):
        if changes.next_decision[vehicle] > now or changes.distance[vehicle] > 0.0:
            continue
        lane = background.lane[vehicle]
        if graph.left[lane] < 0 and graph.right[lane] < 0:
            continue
        _decide(traffic, ego, vehicle, lane, now)


@part
def _decide(traffic: Traffic, ego: Floats, vehicle: int, lane: int, now: float) -> None:
    """Begin a change to a side if it is mandatory or gains enough."""
    changes, right_of_way = traffic.lane_changes, traffic.right_of_way
    mandatory = traffic.lane_links.mandatory_side[lane] >= 0
    changes.next_decision[vehicle] = now + (DECISION_INTERVAL / 3.0 if mandatory else DECISION_INTERVAL)
    _request_gap(traffic, vehicle, lane, now)
    distance = _distance_of_change(traffic, vehicle, mandatory)
    crosses = right_of_way.granted[vehicle] != NONE or right_of_way.crossing[vehicle] != NONE
    if distance == 0.0 or crosses or traffic.background.crashed[vehicle]:
        return
    if _is_near_ego(traffic, ego, vehicle):
        changes.requests_gap[vehicle] = False
        return
    side = _best_side(traffic, vehicle, lane, distance, mandatory)
    if side != NONE:
        _begin_change(traffic, vehicle, lane, side, distance, now)


@part
def _distance_of_change(traffic: Traffic, vehicle: int, mandatory: bool) -> float:
    """Return the metres that a change would take now; 0 where no discretionary change may begin."""
    speed, position = traffic.background.speed[vehicle], traffic.scratch.position[vehicle]
    rest = traffic.lane_links.length[traffic.scratch.link[vehicle]] - position
    distance = min(max(CHANGE_TIME * speed, SHORTEST_CHANGE), LONGEST_CHANGE)
    if mandatory:
        return min(distance, max(rest - 1.0, _END_CLEARANCE))
    if rest < distance + NO_CHANGE_BEFORE_END or speed < 1.0:
        return 0.0
    return distance


@part
def _is_near_ego(traffic: Traffic, ego: Floats, vehicle: int) -> bool:
    """Tell whether a vehicle is so near to the ego that it must not change lanes."""
    if ego[PRESENT] <= 0.0:
        return False
    x, y = traffic.background.x[vehicle], traffic.background.y[vehicle]
    return math.hypot(ego[X] - x, ego[Y] - y) < EGO_CLEARANCE + abs(ego[SPEED])


@part
def _best_side(traffic: Traffic, vehicle: int, lane: int, distance: float, mandatory: bool) -> int:
    """Return the side (0 left, 1 right) to which a change gains most, -1 if none gains enough."""
    graph, lane_links = traffic.graph, traffic.lane_links
    best_side, best_gain = NONE, LEAST_GAIN
    at_random = (
        not mandatory
        and random_below(traffic.background.random_state[vehicle : vehicle + 1], 1000) < RANDOM_CHANGE_CHANCE
    )
    for side in range(2):
        if mandatory and side != lane_links.mandatory_side[lane]:
            continue
        other = graph.left[lane] if side == 0 else graph.right[lane]
        if other < 0 or (not mandatory and lane_links.mandatory_side[other] >= 0):
            continue
        gain = gain_of_change(traffic, vehicle, lane, other, side, distance, mandatory)
        if at_random and gain > -LEAST_GAIN:
            gain = 1.0
        if gain > best_gain:
            best_side, best_gain = side, gain
    return best_side


@part
def _request_gap(traffic: Traffic, vehicle: int, lane: int, now: float) -> None:
    """Note whether a vehicle stands where its lane ends, since when, and whether it requests a gap."""
    background, changes, lane_links = traffic.background, traffic.lane_changes, traffic.lane_links
    mandatory_side = lane_links.mandatory_side[lane]
    link = traffic.scratch.link[vehicle]
    waits = (
        mandatory_side >= 0
        and background.speed[vehicle] < 1.0
        and lane_links.room[link] - traffic.scratch.position[vehicle] < 0.5 * background.length[vehicle] + 4.0
    )
    if not waits:
        changes.waiting_since[vehicle] = math.inf
    elif changes.waiting_since[vehicle] == math.inf:
        changes.waiting_since[vehicle] = now
    changes.requests_gap[vehicle] = waits and now - changes.waiting_since[vehicle] > REQUEST_AFTER
    if changes.requests_gap[vehicle]:
        changes.side[vehicle] = mandatory_side


@part
def _begin_change(traffic: Traffic, vehicle: int, lane: int, side: int, distance: float, now: float) -> None:
    """Put a vehicle on the lane beside, with its present offset to that lane."""
    background, changes, lane_links = traffic.background, traffic.lane_changes, traffic.lane_links
    graph, scratch, right_of_way = traffic.graph, traffic.scratch, traffic.right_of_way
    vehicles = background.lane.shape[0]
    other = graph.left[lane] if side == 0 else graph.right[lane]
    s, lateral = lane_project(graph, other, background.x[vehicle], background.y[vehicle])
    s = min(max(s, 0.0), graph.length[other])
    background.lane[vehicle], background.s[vehicle], background.offset[vehicle] = other, s, lateral
    background.path[vehicle, 0] = lane_links.link[other]
    plan_from(lane_links, background, vehicle, 1)
    changes.start_offset[vehicle], changes.driven[vehicle], changes.distance[vehicle] = lateral, 0.0, distance
    changes.side[vehicle], changes.requests_gap[vehicle] = 1 - side, False
    changes.waiting_since[vehicle] = math.inf
    changes.next_decision[vehicle] = now + PAUSE_AFTER_CHANGE
    right_of_way.waiting_since[vehicle] = math.inf
    remove(scratch, vehicle)
    remove(scratch, vehicles + vehicle)
    insert(scratch, vehicle, lane_links.link[other], lane_links.link_offset[other] + s)
    insert_beside(graph, lane_links, scratch, vehicles + vehicle, other, s, 1 - side)


@part
def shift(traffic: Traffic, vehicle: int, driven: float) -> float:
    """Move a changing vehicle sideways for `driven` metres; return its angle to the lane, rad."""
    background, changes = traffic.background, traffic.lane_changes
    changes.driven[vehicle] += driven
    start, distance = changes.start_offset[vehicle], changes.distance[vehicle]
    share = changes.driven[vehicle] / distance
    if share >= 1.0:
        background.offset[vehicle], changes.distance[vehicle] = 0.0, 0.0
        return 0.0
    background.offset[vehicle] = start * (1.0 - share * share * share * (10.0 - share * (15.0 - 6.0 * share)))
    return math.atan(-start * 30.0 * share * share * (1.0 - share) * (1.0 - share) / distance)
