"""The ego as the traffic sees it: the part of every link that it covers, and where on its path it is."""

import math

from athrl_driving.kernels.compilation import inlined, part
from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph
from athrl_driving.maps.levels import VEHICLE_LEVEL_HEIGHT
from athrl_driving.traffic.columns import NONE, EgoOnLinks, RightOfWay, Traffic
from athrl_driving.traffic.ego_columns import ELEVATION, HEADING, LENGTH, SPEED, WIDTH, X, Y
from athrl_driving.traffic.geometry import lane_elevation, lane_project
from athrl_driving.traffic.lane_links import CELL, LaneLinks

ON_THE_LINE = 1.5
"""Metres beyond a stop line that do not count as being in the junction."""

_ALONG = 0.5
_LOCATED_WITHIN = 16


@part
def uncover_links(covered: EgoOnLinks) -> None:
    """Take the ego off all links."""
    for index in range(covered.covered[0]):
        link = covered.links[index]
        covered.rear[link] = math.inf
        covered.front[link] = -math.inf
        if link < covered.blocks.shape[0]:
            covered.blocks[link] = 0
    covered.covered[0] = 0


@part
def cover_links(graph: LaneGraph, lane_links: LaneLinks, covered: EgoOnLinks, ego: Floats) -> None:
    """Note the links that the ego covers. `ego` is float64 [8] (`ego_columns`)."""
    reach = 0.5 * math.hypot(ego[LENGTH], ego[WIDTH])
    cell_x = int((ego[X] - lane_links.cell_origin[0]) / CELL)
    cell_y = int((ego[Y] - lane_links.cell_origin[1]) / CELL)
    if ego[X] < lane_links.cell_origin[0] or ego[Y] < lane_links.cell_origin[1]:
        return
    if cell_x >= lane_links.cell_counts[0] or cell_y >= lane_links.cell_counts[1]:
        return
    cell = cell_y * lane_links.cell_counts[0] + cell_x
    for index in range(lane_links.cell_start[cell], lane_links.cell_start[cell + 1]):
        lane = lane_links.cell_lane[index]
        s, lateral = lane_project(graph, lane, ego[X], ego[Y])
        if (
            abs(lateral) <= 0.5 * graph.width[lane] + reach
            and -reach <= s <= graph.length[lane] + reach
            and abs(lane_elevation(graph, lane, s) - ego[ELEVATION]) <= VEHICLE_LEVEL_HEIGHT
        ):
            _cover_lane(graph, lane_links, covered, ego, lane)


@part
def _cover_lane(graph: LaneGraph, lane_links: LaneLinks, covered: EgoOnLinks, ego: Floats, lane: int) -> None:
    """Project points of the body, at most about 1 m apart, onto one lane."""
    cos, sin = math.cos(ego[HEADING]), math.sin(ego[HEADING])
    rear, front = math.inf, -math.inf
    for line in range(-1, 2):
        across = 0.5 * line * ego[WIDTH]
        for column in range(-3, 4):
            along = column * ego[LENGTH] / 6.0
            x, y = ego[X] + along * cos - across * sin, ego[Y] + along * sin + across * cos
            s, lateral = lane_project(graph, lane, x, y)
            if abs(lateral) <= 0.5 * graph.width[lane] and -0.01 <= s <= graph.length[lane] + 0.01:
                rear, front = min(rear, s), max(front, s)
    if rear == math.inf:
        return
    angle = ego[HEADING] - graph.start_heading[lane] - graph.curvature[lane] * 0.5 * (rear + front)
    link, before = lane_links.link[lane], lane_links.link_offset[lane]
    if covered.rear[link] == math.inf:
        covered.links[covered.covered[0]] = link
        covered.covered[0] += 1
    covered.rear[link] = min(covered.rear[link], before + rear)
    covered.front[link] = max(covered.front[link], before + front)
    covered.speed[link] = ego[SPEED] * math.cos(angle)
    if link < covered.blocks.shape[0] and before + front >= ON_THE_LINE:
        covered.blocks[link] = max(covered.blocks[link], 2 if math.cos(angle) > _ALONG else 1)


@part
def follow_path(
    graph: LaneGraph, lane_links: LaneLinks, covered: EgoOnLinks, ego: Floats, path: Integers
) -> bool:
    """Locate the ego on its path, and note the path's links; tell whether the ego is on its path."""
    place, s = _locate(graph, ego, path)
    count = 0
    if place >= 0:
        base = -s
        for index in range(place, path.shape[0]):
            lane = path[index]
            if lane < 0 or count == covered.path_link.shape[0]:
                break
            link, before = lane_links.link[lane], lane_links.link_offset[lane]
            if count == 0 or covered.path_link[count - 1] != link:
                covered.path_link[count], covered.path_base[count] = link, base - before
                count += 1
            covered.path_until[count - 1] = base + graph.length[lane] - covered.path_base[count - 1]
            following = path[index + 1] if index + 1 < path.shape[0] else NONE
            # Where the ego changes lanes, the neighbour follows, which starts at the same station.
            if following < 0 or (
                following != lane_links.beside[lane, 0] and following != lane_links.beside[lane, 1]
            ):
                base += graph.length[lane]
    if count < covered.path_link.shape[0]:
        covered.path_link[count] = NONE
    return place >= 0


@part
def _locate(graph: LaneGraph, ego: Floats, path: Integers) -> tuple[int, float]:
    """Return (place in the path, m along that lane) of the ego; place -1 if it is off the path."""
    best_place, best_s, best = -1, 0.0, math.inf
    for place in range(min(path.shape[0], _LOCATED_WITHIN)):
        lane = path[place]
        if lane < 0:
            break
        s, lateral = lane_project(graph, lane, ego[X], ego[Y])
        distance = abs(lateral) + max(-s, 0.0) + max(s - graph.length[lane], 0.0)
        if distance < best and distance <= graph.width[lane]:
            best_place, best_s, best = place, s, distance
    return best_place, best_s


@part
def note_crossing(right_of_way: RightOfWay, covered: EgoOnLinks, vehicle: int, length: float) -> None:
    """Note the movement that the ego is on, until its rear has left it."""
    link = covered.path_link[0]
    if 0 <= link < right_of_way.holders.shape[0]:
        right_of_way.crossing[vehicle] = link
        if right_of_way.granted[vehicle] == link:
            right_of_way.granted[vehicle] = NONE
    elif link < 0 or -covered.path_base[0] > 0.5 * length:
        right_of_way.crossing[vehicle] = NONE


@inlined
def ego_may_enter(traffic: Traffic) -> bool:
    """Tell whether the ego holds the next movement on its path, or none is near, as of the last tick."""
    ego = traffic.background.lane.shape[0]
    ahead = traffic.right_of_way.ahead[ego]
    return ahead == NONE or traffic.right_of_way.granted[ego] == ahead


@inlined
def ego_stop_line(traffic: Traffic) -> float:
    """Return the distance (m) from the ego's front to its next stop line; infinite where none is near."""
    return float(traffic.right_of_way.line_distance[traffic.background.lane.shape[0]])
