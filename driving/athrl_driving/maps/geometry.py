"""Poses on lanes, and the lane of a pose, compiled.

The conventions are those of highway-env's `StraightLane` and `CircularLane`: longitudinal along the centre
line from the lane's start, lateral positive to the driver's right. Headings are radians, distances metres.
"""

import math

from athrl_driving.kernels.compilation import compiled, inlined
from athrl_driving.maps.lane_graph import GRID_CELL, LaneGraph


@compiled
def lane_pose(graph: LaneGraph, lane: int, s: float) -> tuple[float, float, float]:
    """Return (x, y, heading) at `s` metres along a lane."""
    curvature = graph.curvature[lane]
    heading = graph.start_heading[lane]
    cos0, sin0 = graph.start_cos[lane], graph.start_sin[lane]
    if curvature == 0.0:
        return graph.start_x[lane] + s * cos0, graph.start_y[lane] + s * sin0, heading
    heading += curvature * s
    x = graph.start_x[lane] + (math.sin(heading) - sin0) / curvature
    y = graph.start_y[lane] - (math.cos(heading) - cos0) / curvature
    return x, y, heading


@compiled
def lane_project(graph: LaneGraph, lane: int, x: float, y: float) -> tuple[float, float]:
    """Return (longitudinal, lateral) of a point on a lane; on an arc only within half a circle."""
    curvature = graph.curvature[lane]
    cos0, sin0 = graph.start_cos[lane], graph.start_sin[lane]
    dx, dy = x - graph.start_x[lane], y - graph.start_y[lane]
    if curvature == 0.0:
        return dx * cos0 + dy * sin0, dy * cos0 - dx * sin0
    radius = 1.0 / curvature
    # Seen from the centre of the circle: `radius * (sin0, -cos0)` points to the start.
    dx += radius * sin0
    dy -= radius * cos0
    along = (dx * cos0 + dy * sin0) * radius
    across = (dx * sin0 - dy * cos0) * radius
    travelled = math.atan2(along, across)
    distance = math.hypot(dx, dy)
    lateral = radius - distance if radius > 0.0 else radius + distance
    return travelled * radius, lateral


@inlined
def lane_elevation(graph: LaneGraph, lane: int, s: float) -> float:
    """Return the height (m) at `s` metres along a lane."""
    return graph.elevation[lane] + graph.grade[lane] * s


@compiled
def closest_lane(graph: LaneGraph, x: float, y: float, heading: float) -> int:
    """Return the lane nearest to a pose: lateral distance, plus distance beyond the ends, plus the angle.

    The measure is that of highway-env's `distance_with_heading`; ties go to the first lane. It is never less
    than the distance in the plane, so cells farther away than the best lane so far need not be searched.
    """
    columns, rows = graph.grid_shape[0], graph.grid_shape[1]
    column = math.floor((x - graph.grid_origin[0]) / GRID_CELL)
    row = math.floor((y - graph.grid_origin[1]) / GRID_CELL)
    # How far the pose is from the border of its own cell.
    inside_x = x - graph.grid_origin[0] - column * GRID_CELL
    inside_y = y - graph.grid_origin[1] - row * GRID_CELL
    border = min(inside_x, GRID_CELL - inside_x, inside_y, GRID_CELL - inside_y)
    best, best_distance = 0, math.inf
    ring = max(0, -column, column - columns + 1, -row, row - rows + 1)
    farthest = max(abs(column), abs(column - columns), abs(row), abs(row - rows))
    while ring <= farthest and best_distance > (ring - 1) * GRID_CELL + border:
        for cell_row in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            on_edge = abs(cell_row - row) == ring
            step = 1 if on_edge or ring == 0 else 2 * ring
            cell_column = column - ring
            while cell_column <= column + ring:
                if 0 <= cell_column < columns:
                    cell = cell_row * columns + cell_column
                    for index in range(graph.grid_start[cell], graph.grid_start[cell + 1]):
                        lane = graph.grid_lane[index]
                        distance = _pose_distance(graph, lane, x, y, heading)
                        if distance < best_distance or (distance == best_distance and lane < best):
                            best, best_distance = lane, distance
                cell_column += step
        ring += 1
    return best


@inlined
def _pose_distance(graph: LaneGraph, lane: int, x: float, y: float, heading: float) -> float:
    s, lateral = lane_project(graph, lane, x, y)
    distance = abs(lateral) + max(s - graph.length[lane], 0.0) + max(-s, 0.0)
    angle = heading - graph.start_heading[lane] - graph.curvature[lane] * s
    return distance + abs((angle + math.pi) % (2.0 * math.pi) - math.pi)
