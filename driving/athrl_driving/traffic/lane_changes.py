"""Lane changes: when a vehicle shifts to the lane beside, and how it gets there.

It changes where its own lane ends, where it would get on better at little cost to who is behind there
(MOBIL), and now and then for no reason, so that every lane of a ring is used. It takes a gap only where
whoever is behind brakes gently at most, nobody is on the way out of a junction towards it, and the ego is not
near. Where a lane ends it waits for a gap; after `ASKS_AFTER` those beside who can stop easily let it in, one
for one.
"""

import math

from athrl_driving.compilation import part
from athrl_driving.maps.lane_graph import Floats
from athrl_driving.traffic.columns import NOBODY, Traffic
from athrl_driving.traffic.following import REFERENCE_LENGTH, approach_speed, idm_acceleration
from athrl_driving.traffic.geometry import lane_project
from athrl_driving.traffic.nodes import insert, insert_beside, owner, remove
from athrl_driving.traffic.paths import plan_from, random_below
from athrl_driving.traffic.rails import CURVE_BRAKING

CHANGE_TIME = 3.0
"""Seconds that a change takes, as far as the least and the greatest way allow."""

SHORTEST_CHANGE, LONGEST_CHANGE = 12.0, 25.0
"""Metres."""

ASKS_AFTER = 3.0
"""Seconds of standing where a lane ends after which a vehicle asks to be let in."""

POLITENESS = 0.3
"""How much the loss of the vehicle behind counts beside one's own gain."""

LEAST_GAIN = 0.3
"""m/s2 of acceleration for which a vehicle changes."""

URGE = 15
"""Chance in a thousand, at each thought, of a change for no reason that costs nobody anything."""

THINKS_EVERY = 1.0
"""Seconds; three times as often where the lane ends."""

AGAIN_AFTER = 6.0
"""Seconds from a change's begin to the next thought of one."""

GENTLE_BRAKING = 2.5
"""m/s2 that a change may ask of whoever is behind."""

BEFORE_A_LINE = 40.0
"""Metres before a link's end where nobody begins a change but for a lane's end."""

CLEAR_OF_THE_EGO = 15.0
"""Metres from the ego, and as many more as it drives in a second, within which nobody begins a change."""

BEHIND_A_JUNCTION = 45.0
"""Metres from a junction's exit that are kept for those who come out of it."""

_LEAST_GAP = 2.0
_GAP_TIME = 0.3
_GAP_MARGIN = 1.5
_CLEAR_OF_THE_END = 8.0
_ROOM_AT_THE_LINE = 0.6


@part
def change_lanes(traffic: Traffic, ego: Floats) -> None:
    """Let everybody whose time it is think of a change and begin it."""
    background, changes, graph = traffic.background, traffic.lane_changes, traffic.graph
    now = traffic.scratch.clock[0]
    for row in range(background.lane.shape[0]):
        if changes.next_thought[row] > now or changes.over[row] > 0.0:
            continue
        lane = background.lane[row]
        if graph.left[lane] < 0 and graph.right[lane] < 0:
            continue
        _think(traffic, ego, row, lane, now)


@part
def _think(traffic: Traffic, ego: Floats, row: int, lane: int, now: float) -> None:
    """Begin the change to a side that is needed or is worth it."""
    background, changes, rails = traffic.background, traffic.lane_changes, traffic.rails
    right_of_way, graph, scratch = traffic.right_of_way, traffic.graph, traffic.scratch
    way_out = rails.way_out[lane]
    needed = way_out >= 0
    changes.next_thought[row] = now + (THINKS_EVERY / 3.0 if needed else THINKS_EVERY)
    _ask_to_be_let_in(traffic, row, lane, now)
    at = scratch.position[row]
    rest = rails.length[scratch.link[row]] - at
    distance = min(max(CHANGE_TIME * background.speed[row], SHORTEST_CHANGE), LONGEST_CHANGE)
    if needed:
        distance = min(distance, max(rest - 1.0, _CLEAR_OF_THE_END))
    elif rest < distance + BEFORE_A_LINE or background.speed[row] < 1.0:
        return
    if right_of_way.granted[row] != NOBODY or right_of_way.crossing[row] != NOBODY or background.crashed[row]:
        return
    if ego[7] > 0.0:
        near = CLEAR_OF_THE_EGO + abs(ego[3])
        if math.hypot(ego[0] - background.x[row], ego[1] - background.y[row]) < near:
            changes.asks[row] = False
            return
    best_side, best_gain = NOBODY, LEAST_GAIN
    urge = not needed and random_below(background, row, 1000) < URGE
    for side in range(2):
        if needed and side != way_out:
            continue
        other = graph.left[lane] if side == 0 else graph.right[lane]
        if other < 0 or (not needed and rails.way_out[other] >= 0):
            continue
        gain = _gain(traffic, row, lane, other, side, distance, needed)
        if urge and gain > -LEAST_GAIN:
            gain = 1.0
        if gain > best_gain:
            best_side, best_gain = side, gain
    if best_side != NOBODY:
        _begin(traffic, row, lane, best_side, distance, now)


@part
def _ask_to_be_let_in(traffic: Traffic, row: int, lane: int, now: float) -> None:
    """Note who stands where its lane ends, and since when."""
    background, changes, rails = traffic.background, traffic.lane_changes, traffic.rails
    way_out = rails.way_out[lane]
    link = traffic.scratch.link[row]
    waits = (
        way_out >= 0
        and background.speed[row] < 1.0
        and rails.room[link] - traffic.scratch.position[row] < 0.5 * background.length[row] + 4.0
    )
    if not waits:
        changes.wanted_since[row] = math.inf
    elif changes.wanted_since[row] == math.inf:
        changes.wanted_since[row] = now
    changes.asks[row] = waits and now - changes.wanted_since[row] > ASKS_AFTER
    if changes.asks[row]:
        changes.side[row] = way_out


@part
def _gain(
    traffic: Traffic, row: int, lane: int, other: int, side: int, distance: float, needed: bool
) -> float:
    """Return what a change gains (m/s2, as MOBIL counts); minus infinity where it is not safe."""
    background, graph, rails, scratch = traffic.background, traffic.graph, traffic.rails, traffic.scratch
    vehicles = background.lane.shape[0]
    s = background.s[row] * graph.length[other] / graph.length[lane]
    link, position = rails.link[other], rails.link_offset[other] + s
    # Behind the change there has to be room to stop at the line.
    room = rails.length[link] - position - 0.5 * background.length[row] - distance
    if room < _ROOM_AT_THE_LINE + background.speed[row] ** 2 / (2.0 * CURVE_BRAKING):
        return -math.inf
    if not _goes_on_beside(traffic, link, other, s, scratch.link[row], side, distance):
        return -math.inf
    if position < BEHIND_A_JUNCTION and traffic.right_of_way.inbound[link] > 0:
        return -math.inf
    if traffic.ego_on_links.rear[link] < math.inf and not needed:
        return -math.inf
    speed, length = background.speed[row], background.length[row]
    behind, ahead = scratch.last[link], NOBODY
    while behind != NOBODY and (scratch.position[behind] > position or _only_asks(traffic, behind)):
        if not _only_asks(traffic, behind):
            ahead = behind
        behind = scratch.preceding[behind]
    gap, leader_speed = math.inf, 0.0
    if ahead != NOBODY:
        leader = owner(ahead, vehicles)
        gap = scratch.position[ahead] - position - 0.5 * (length + background.length[leader])
        leader_speed = background.speed[leader]
    else:
        gap, leader_speed = _beyond(traffic, link, position, length)
    if not _is_safe(gap, speed, leader_speed):
        return -math.inf
    follower_gap, follower = math.inf, NOBODY
    if behind != NOBODY:
        follower = owner(behind, vehicles)
        follower_gap = position - scratch.position[behind] - 0.5 * (length + background.length[follower])
    else:
        follower, follower_gap = _before(traffic, link, position, length)
    if follower == NOBODY:
        if follower_gap < math.inf:
            return -math.inf
    elif not _is_safe(follower_gap, background.speed[follower], speed):
        return -math.inf
    if needed:
        return math.inf
    target = min(background.desired_speed[row], rails.pace[lane])
    gain = idm_acceleration(speed, target, gap + REFERENCE_LENGTH, leader_speed)
    gain -= idm_acceleration(speed, target, scratch.gap[row] + REFERENCE_LENGTH, scratch.leader_speed[row])
    if follower != NOBODY:
        behind_speed, behind_target = background.speed[follower], background.desired_speed[follower]
        before = idm_acceleration(
            behind_speed, behind_target, follower_gap + length + gap + REFERENCE_LENGTH, leader_speed
        )
        after = idm_acceleration(behind_speed, behind_target, follower_gap + REFERENCE_LENGTH, speed)
        gain += POLITENESS * (after - before)
    return gain


@part
def _only_asks(traffic: Traffic, node: int) -> bool:
    """Tell whether a node is no body but a request to be let in."""
    vehicles = traffic.background.lane.shape[0]
    return node >= vehicles and traffic.lane_changes.asks[node - vehicles]


@part
def _is_safe(gap: float, speed: float, leader_speed: float) -> bool:
    """Tell whether who drives `gap` metres behind a leader has to brake gently at most."""
    if gap == math.inf:
        return True
    if gap < _LEAST_GAP + _GAP_TIME * speed:
        return False
    return speed <= approach_speed(gap - _GAP_MARGIN, max(leader_speed, 0.0), GENTLE_BRAKING, 0.1)


@part
def _goes_on_beside(
    traffic: Traffic, link: int, row: int, s: float, own_link: int, side: int, distance: float
) -> bool:
    """Tell whether both lanes run beside each other for `distance` metres from `s` on `row` of `link`."""
    rails, graph = traffic.rails, traffic.graph
    place = rails.place[row]
    covered = graph.length[row] - s
    while covered < distance:
        place += 1
        if place >= rails.row_start[link + 1]:
            return False
        row = rails.rows[place]
        beside = rails.beside[row, 1 - side]
        if beside < 0 or rails.link[beside] != own_link:
            return False
        covered += graph.length[row]
    return True


@part
def _beyond(traffic: Traffic, link: int, position: float, length: float) -> tuple[float, float]:
    """Return gap and speed of the nearest vehicle on ordinary links after `link`."""
    rails, scratch, background = traffic.rails, traffic.scratch, traffic.background
    gap, speed = math.inf, 0.0
    for index in range(rails.next_start[link], rails.next_start[link + 1]):
        node = scratch.first[rails.next[index]]
        if node == NOBODY:
            continue
        leader = owner(node, background.lane.shape[0])
        distance = rails.length[link] - position + scratch.position[node]
        distance -= 0.5 * (length + background.length[leader])
        if distance < gap:
            gap, speed = distance, background.speed[leader]
    return gap, speed


@part
def _before(traffic: Traffic, link: int, position: float, length: float) -> tuple[int, float]:
    """Return the nearest vehicle on the links before `link` and the gap to it; -1 and inf without one."""
    rails, scratch, background = traffic.rails, traffic.scratch, traffic.background
    follower, gap = NOBODY, math.inf
    for index in range(rails.previous_start[link], rails.previous_start[link + 1]):
        before = rails.previous[index]
        node = scratch.last[before]
        if node == NOBODY:
            continue
        other = owner(node, background.lane.shape[0])
        distance = position + rails.length[before] - scratch.position[node]
        distance -= 0.5 * (length + background.length[other])
        if distance < gap:
            follower, gap = other, distance
    return follower, gap


@part
def _begin(traffic: Traffic, row: int, lane: int, side: int, distance: float, now: float) -> None:
    """Put a vehicle on the lane beside, as far aside as it is."""
    background, changes, rails = traffic.background, traffic.lane_changes, traffic.rails
    graph, scratch, right_of_way = traffic.graph, traffic.scratch, traffic.right_of_way
    vehicles = background.lane.shape[0]
    other = graph.left[lane] if side == 0 else graph.right[lane]
    s, lateral = lane_project(graph, other, background.x[row], background.y[row])
    s = min(max(s, 0.0), graph.length[other])
    background.lane[row], background.s[row], background.offset[row] = other, s, lateral
    background.path[row, 0] = rails.link[other]
    plan_from(rails, background, row, 1)
    changes.start_offset[row], changes.driven[row], changes.over[row] = lateral, 0.0, distance
    changes.side[row], changes.asks[row], changes.wanted_since[row] = 1 - side, False, math.inf
    changes.next_thought[row] = now + AGAIN_AFTER
    right_of_way.waiting_since[row] = math.inf
    remove(scratch, row)
    remove(scratch, vehicles + row)
    insert(scratch, row, rails.link[other], rails.link_offset[other] + s)
    insert_beside(graph, rails, scratch, vehicles + row, other, s, 1 - side)


@part
def shift(traffic: Traffic, row: int, driven: float) -> float:
    """Move a changing vehicle sideways for `driven` metres; return its angle to the lane, rad."""
    background, changes = traffic.background, traffic.lane_changes
    changes.driven[row] += driven
    start, over = changes.start_offset[row], changes.over[row]
    share = changes.driven[row] / over
    if share >= 1.0:
        background.offset[row], changes.over[row] = 0.0, 0.0
        return 0.0
    background.offset[row] = start * (1.0 - share * share * share * (10.0 - share * (15.0 - 6.0 * share)))
    return math.atan(-start * 30.0 * share * share * (1.0 - share) * (1.0 - share) / over)
