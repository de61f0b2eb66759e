"""What the planner sees of an episode, compiled."""

from ..compilation import inner
from ..control import MAXIMUM_STEERING
from ..maps.lane_graph import LaneGraph
from ..perception.image import draw_image
from ..reward import FAST_SPEED
from ..route import RouteState
from ..traffic.state import Background
from .ego import HEADING, SPEED, STEERING, X, Y
from .state import Progress, View

MOTION_LIMIT = 2.0
"""Bound of both entries of `motion`."""


@inner
def observe(
    perception: View, graph: LaneGraph, others: Background, route: RouteState, progress: Progress, e: int
) -> None:
    """Draw the image of environment `e` and note its ego's motion; `others` and `route` are its views."""
    ego = progress.ego[e]
    image = draw_image(
        progress.images.shape[1], perception.cells, perception.left, perception.top, graph,
        route.pieces[: route.piece_count[0]], route.position[0], ego[X], ego[Y], ego[HEADING],
        others.x, others.y, others.heading, others.speed, others.lane, others.length, others.width,
    )  # fmt: skip
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            for channel in range(4):
                progress.images[e, row, column, channel] = image[row, column, channel]
    speed, steering = ego[SPEED] / FAST_SPEED, progress.control[e, STEERING] / MAXIMUM_STEERING
    progress.motion[e, 0] = min(max(speed, -MOTION_LIMIT), MOTION_LIMIT)
    progress.motion[e, 1] = min(max(steering, -MOTION_LIMIT), MOTION_LIMIT)
