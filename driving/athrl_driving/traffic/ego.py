"""The ego as the traffic sees it: what it covers of every lane, and where on its path it is."""

import math

from athrl_driving.compilation import inlined
from athrl_driving.maps.geometry import lane_project
from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph
from athrl_driving.traffic.state import NOBODY, EgoOnLanes, Traffic

ON_THE_LINE = 1.5
"""Metres beyond a stop line that do not count as being in the junction."""

_ALONG = 0.5
_LOCATED_WITHIN = 12


@inlined
def forget_ego(covered: EgoOnLanes) -> None:
    """Take the ego off all lanes."""
    for index in range(covered.counts[0]):
        lane = covered.lanes[index]
        covered.rear[lane] = math.inf
        covered.front[lane] = -math.inf
    for index in range(covered.counts[1]):
        covered.blocks[covered.movements[index]] = 0
    covered.counts[0] = 0
    covered.counts[1] = 0


@inlined
def cover_lanes(graph: LaneGraph, covered: EgoOnLanes, ego: Floats) -> None:
    """Note what the ego covers. `ego` is as in `state.EGO_FIELDS`."""
    forget_ego(covered)
    reach = 0.5 * math.hypot(ego[4], ego[5])
    for lane in range(graph.length.shape[0]):
        box = graph.box[lane]
        if (
            ego[0] + reach < box[0]
            or ego[1] + reach < box[1]
            or ego[0] - reach > box[2]
            or ego[1] - reach > box[3]
        ):
            continue
        _cover_lane(graph, covered, ego, lane)
    for index in range(covered.counts[0]):
        lane = covered.lanes[index]
        movement = graph.movement[lane]
        if movement < 0 or graph.movement_offset[lane] + covered.front[lane] < ON_THE_LINE:
            continue
        middle = 0.5 * (covered.rear[lane] + covered.front[lane])
        angle = ego[2] - graph.start_heading[lane] - graph.curvature[lane] * middle
        if covered.blocks[movement] == 0:
            covered.movements[covered.counts[1]] = movement
            covered.counts[1] += 1
        covered.blocks[movement] = max(covered.blocks[movement], 2 if math.cos(angle) > _ALONG else 1)


@inlined
def _cover_lane(graph: LaneGraph, covered: EgoOnLanes, ego: Floats, lane: int) -> None:
    """Project points round the body, at most about 1 m apart, on one lane."""
    cos, sin = math.cos(ego[2]), math.sin(ego[2])
    rear, front = math.inf, -math.inf
    for row in range(-1, 2):
        across = 0.5 * row * ego[5]
        for column in range(-3, 4):
            along = column * ego[4] / 6.0
            x, y = ego[0] + along * cos - across * sin, ego[1] + along * sin + across * cos
            s, lateral = lane_project(graph, lane, x, y)
            if abs(lateral) <= 0.5 * graph.width[lane] and -0.01 <= s <= graph.length[lane] + 0.01:
                rear, front = min(rear, s), max(front, s)
    if rear < math.inf:
        middle = 0.5 * (rear + front)
        angle = ego[2] - graph.start_heading[lane] - graph.curvature[lane] * middle
        covered.lanes[covered.counts[0]] = lane
        covered.counts[0] += 1
        covered.rear[lane], covered.front[lane] = rear, front
        covered.speed[lane] = ego[3] * math.cos(angle)


@inlined
def locate_on_path(graph: LaneGraph, ego: Floats, path: Integers) -> tuple[int, float]:
    """Return (place in the path, m along that lane) of the ego; place -1 where it is off the path."""
    best_place, best_s, best = -1, 0.0, math.inf
    for place in range(min(path.shape[0], _LOCATED_WITHIN)):
        lane = path[place]
        if lane < 0:
            break
        s, lateral = lane_project(graph, lane, ego[0], ego[1])
        distance = abs(lateral) + max(-s, 0.0) + max(s - graph.length[lane], 0.0)
        if distance < best and distance <= graph.width[lane]:
            best_place, best_s, best = place, s, distance
    return best_place, best_s


@inlined
def ego_leader(traffic: Traffic) -> tuple[float, float]:
    """Return (gap m, speed m/s) of the next vehicle on the ego's path after a look; (inf, 0) without one."""
    row = traffic.background.lane.shape[0]
    return float(traffic.scratch.gap[row]), float(traffic.scratch.leader_speed[row])


@inlined
def ego_may_enter(traffic: Traffic) -> bool:
    """Tell whether the ego holds the next movement on its path, or none is near, as of the last look."""
    row = traffic.background.lane.shape[0]
    ahead = traffic.right_of_way.ahead[row]
    return ahead == NOBODY or traffic.right_of_way.granted[row] == ahead


@inlined
def ego_stop_line(traffic: Traffic) -> float:
    """Return the distance (m) from the ego's front to its next stop line; infinite where none is near."""
    return float(traffic.right_of_way.line_distance[traffic.background.lane.shape[0]])
