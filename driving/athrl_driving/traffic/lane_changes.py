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
from athrl_driving.traffic.geometry import lane_project
from athrl_driving.traffic.lane_change_gain import gain_of_change
from athrl_driving.traffic.nodes import insert, insert_beside, remove
from athrl_driving.traffic.paths import plan_from, random_below

CHANGE_TIME = 3.0
"""Seconds that a change takes, as far as the least and the greatest way allow."""

SHORTEST_CHANGE, LONGEST_CHANGE = 12.0, 25.0
"""Metres."""

ASKS_AFTER = 3.0
"""Seconds of standing where a lane ends after which a vehicle asks to be let in."""

LEAST_GAIN = 0.3
"""m/s2 of acceleration for which a vehicle changes."""

URGE = 15
"""Chance in a thousand, at each thought, of a change for no reason that costs nobody anything."""

THINKS_EVERY = 1.0
"""Seconds; three times as often where the lane ends."""

AGAIN_AFTER = 6.0
"""Seconds from a change's begin to the next thought of one."""

BEFORE_A_LINE = 40.0
"""Metres before a link's end where nobody begins a change but for a lane's end."""

CLEAR_OF_THE_EGO = 15.0
"""Metres from the ego, and as many more as it drives in a second, within which nobody begins a change."""

_CLEAR_OF_THE_END = 8.0


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
    changes, right_of_way = traffic.lane_changes, traffic.right_of_way
    needed = traffic.rails.way_out[lane] >= 0
    changes.next_thought[row] = now + (THINKS_EVERY / 3.0 if needed else THINKS_EVERY)
    _ask_to_be_let_in(traffic, row, lane, now)
    distance = _distance_of_change(traffic, row, needed)
    crosses = right_of_way.granted[row] != NOBODY or right_of_way.crossing[row] != NOBODY
    if distance == 0.0 or crosses or traffic.background.crashed[row]:
        return
    if _is_near_ego(traffic, ego, row):
        changes.asks[row] = False
        return
    side = _best_side(traffic, row, lane, distance, needed)
    if side != NOBODY:
        _begin(traffic, row, lane, side, distance, now)


@part
def _distance_of_change(traffic: Traffic, row: int, needed: bool) -> float:
    """Return the metres that a change would take now; 0 where none that is not needed may begin."""
    speed, position = traffic.background.speed[row], traffic.scratch.position[row]
    rest = traffic.rails.length[traffic.scratch.link[row]] - position
    distance = min(max(CHANGE_TIME * speed, SHORTEST_CHANGE), LONGEST_CHANGE)
    if needed:
        return min(distance, max(rest - 1.0, _CLEAR_OF_THE_END))
    if rest < distance + BEFORE_A_LINE or speed < 1.0:
        return 0.0
    return distance


@part
def _is_near_ego(traffic: Traffic, ego: Floats, row: int) -> bool:
    """Tell whether a vehicle is so near to the ego that it leaves its lane to it."""
    if ego[7] <= 0.0:
        return False
    x, y = traffic.background.x[row], traffic.background.y[row]
    return math.hypot(ego[0] - x, ego[1] - y) < CLEAR_OF_THE_EGO + abs(ego[3])


@part
def _best_side(traffic: Traffic, row: int, lane: int, distance: float, needed: bool) -> int:
    """Return the side (0 left, 1 right) to which a change gains most, -1 where none gains enough."""
    graph, rails = traffic.graph, traffic.rails
    best_side, best_gain = NOBODY, LEAST_GAIN
    urge = not needed and random_below(traffic.background, row, 1000) < URGE
    for side in range(2):
        if needed and side != rails.way_out[lane]:
            continue
        other = graph.left[lane] if side == 0 else graph.right[lane]
        if other < 0 or (not needed and rails.way_out[other] >= 0):
            continue
        gain = gain_of_change(traffic, row, lane, other, side, distance, needed)
        if urge and gain > -LEAST_GAIN:
            gain = 1.0
        if gain > best_gain:
            best_side, best_gain = side, gain
    return best_side


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
