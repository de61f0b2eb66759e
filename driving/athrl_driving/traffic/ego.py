"""The ego as the traffic sees it: what it covers of every link, and where on its path it is."""

import math

from athrl_driving.compilation import inlined, part
from athrl_driving.maps.lane_graph import Floats, Integers, LaneGraph
from athrl_driving.traffic.collision import LEVEL_HEIGHT
from athrl_driving.traffic.columns import NOBODY, EgoOnLinks, RightOfWay, Traffic
from athrl_driving.traffic.geometry import lane_elevation, lane_project
from athrl_driving.traffic.rails import CELL, Rails

ON_THE_LINE = 1.5
"""Metres beyond a stop line that do not count as being in the junction."""

_ALONG = 0.5
_LOCATED_WITHIN = 16


@part
def forget_ego(covered: EgoOnLinks) -> None:
    """Take the ego off all links."""
    for index in range(covered.covered[0]):
        link = covered.links[index]
        covered.rear[link] = math.inf
        covered.front[link] = -math.inf
        if link < covered.blocks.shape[0]:
            covered.blocks[link] = 0
    covered.covered[0] = 0


@part
def cover_links(graph: LaneGraph, rails: Rails, covered: EgoOnLinks, ego: Floats) -> None:
    """Note what the ego covers. `ego` is float64 [8] (`EGO_FIELDS`)."""
    reach = 0.5 * math.hypot(ego[4], ego[5])
    cell_x = int((ego[0] - rails.cell_origin[0]) / CELL)
    cell_y = int((ego[1] - rails.cell_origin[1]) / CELL)
    if ego[0] < rails.cell_origin[0] or ego[1] < rails.cell_origin[1]:
        return
    if cell_x >= rails.cell_counts[0] or cell_y >= rails.cell_counts[1]:
        return
    cell = cell_y * rails.cell_counts[0] + cell_x
    for index in range(rails.cell_start[cell], rails.cell_start[cell + 1]):
        row = rails.cell_row[index]
        s, lateral = lane_project(graph, row, ego[0], ego[1])
        if (
            abs(lateral) <= 0.5 * graph.width[row] + reach
            and -reach <= s <= graph.length[row] + reach
            and abs(lane_elevation(graph, row, s) - ego[6]) <= LEVEL_HEIGHT
        ):
            _cover_row(graph, rails, covered, ego, row)


@part
def _cover_row(graph: LaneGraph, rails: Rails, covered: EgoOnLinks, ego: Floats, row: int) -> None:
    """Project points round the body, at most about 1 m apart, on one row."""
    cos, sin = math.cos(ego[2]), math.sin(ego[2])
    rear, front = math.inf, -math.inf
    for line in range(-1, 2):
        across = 0.5 * line * ego[5]
        for column in range(-3, 4):
            along = column * ego[4] / 6.0
            x, y = ego[0] + along * cos - across * sin, ego[1] + along * sin + across * cos
            s, lateral = lane_project(graph, row, x, y)
            if abs(lateral) <= 0.5 * graph.width[row] and -0.01 <= s <= graph.length[row] + 0.01:
                rear, front = min(rear, s), max(front, s)
    if rear == math.inf:
        return
    angle = ego[2] - graph.start_heading[row] - graph.curvature[row] * 0.5 * (rear + front)
    link, before = rails.link[row], rails.link_offset[row]
    if covered.rear[link] == math.inf:
        covered.links[covered.covered[0]] = link
        covered.covered[0] += 1
    covered.rear[link] = min(covered.rear[link], before + rear)
    covered.front[link] = max(covered.front[link], before + front)
    covered.speed[link] = ego[3] * math.cos(angle)
    if link < covered.blocks.shape[0] and before + front >= ON_THE_LINE:
        covered.blocks[link] = max(covered.blocks[link], 2 if math.cos(angle) > _ALONG else 1)


@part
def follow_path(graph: LaneGraph, rails: Rails, covered: EgoOnLinks, ego: Floats, path: Integers) -> bool:
    """Find the ego on its path, note the links of it and where they are; tell whether it is on its path."""
    place, s = _locate(graph, ego, path)
    count = 0
    if place >= 0:
        base = -s
        for index in range(place, path.shape[0]):
            row = path[index]
            if row < 0 or count == covered.path_link.shape[0]:
                break
            link, before = rails.link[row], rails.link_offset[row]
            if count == 0 or covered.path_link[count - 1] != link:
                covered.path_link[count], covered.path_base[count] = link, base - before
                count += 1
            covered.path_until[count - 1] = base + graph.length[row] - covered.path_base[count - 1]
            following = path[index + 1] if index + 1 < path.shape[0] else NOBODY
            # A neighbour follows where the ego changes lanes: that starts at the same station.
            if following < 0 or (following != rails.beside[row, 0] and following != rails.beside[row, 1]):
                base += graph.length[row]
    if count < covered.path_link.shape[0]:
        covered.path_link[count] = NOBODY
    return place >= 0


@part
def _locate(graph: LaneGraph, ego: Floats, path: Integers) -> tuple[int, float]:
    """Return (place in the path, m along that row) of the ego; place -1 where it is off the path."""
    best_place, best_s, best = -1, 0.0, math.inf
    for place in range(min(path.shape[0], _LOCATED_WITHIN)):
        row = path[place]
        if row < 0:
            break
        s, lateral = lane_project(graph, row, ego[0], ego[1])
        distance = abs(lateral) + max(-s, 0.0) + max(s - graph.length[row], 0.0)
        if distance < best and distance <= graph.width[row]:
            best_place, best_s, best = place, s, distance
    return best_place, best_s


@part
def note_crossing(right_of_way: RightOfWay, covered: EgoOnLinks, row: int, length: float) -> None:
    """Note the movement that the ego is on, until its rear has left it."""
    link = covered.path_link[0]
    if 0 <= link < right_of_way.holders.shape[0]:
        right_of_way.crossing[row] = link
        if right_of_way.granted[row] == link:
            right_of_way.granted[row] = NOBODY
    elif link < 0 or -covered.path_base[0] > 0.5 * length:
        right_of_way.crossing[row] = NOBODY


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
