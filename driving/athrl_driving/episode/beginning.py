"""How an episode begins, compiled."""

from athrl_driving.episode.decision import forget_aim
from athrl_driving.episode.ego import place_ego
from athrl_driving.episode.state import DriveSettings, Progress, Views
from athrl_driving.episode.work_flags import WorkOrders
from athrl_driving.kernels.compilation import part
from athrl_driving.maps.geometry import lane_elevation, lane_pose
from athrl_driving.metrics import NO_COLLISION, reset_metrics
from athrl_driving.route import lanes_ahead, start_route
from athrl_driving.traffic.ego_columns import X, Y
from athrl_driving.traffic.spawn import place

CLEARANCE = 8.0
"""No vehicle's centre is within this distance (m) of the ego's when an episode begins."""


@part
def begin(views: Views, settings: DriveSettings, progress: Progress, orders: WorkOrders, e: int) -> None:
    """Begin an episode in environment `e`, whose own traffic, route and metrics are in `views`."""
    graph, route, start = views.traffic.graph, views.route, orders.starts[e]
    lane, s, seeds = int(start[0]), start[1], orders.seeds[e]
    start_route(graph, route, lane, s, seeds[0], orders.plans[e, : orders.plan_lanes[e]], start[2])
    x, y, heading = lane_pose(graph, lane, s)
    place_ego(progress.ego[e], progress.control[e], x, y, heading, lane_elevation(graph, lane, s))
    forget_aim(settings, progress.control[e])
    lanes_ahead(graph, route, progress.path[e])
    _clear_episode(progress, e)
    reset_metrics(views.metrics, 0.0, heading, start[3])
    ego, no_path = progress.ego[e], progress.path[e, :0]
    orders.placed[e] = place(
        views.traffic, seeds[1:], orders.choices[e], no_path, ego[X], ego[Y], CLEARANCE, ego
    )


@part
def _clear_episode(progress: Progress, e: int) -> None:
    """Clear what belongs to the last episode."""
    progress.obstacle_count[e] = 0
    progress.collision[e] = NO_COLLISION
    progress.off_lane[e] = progress.arrived[e] = progress.route_end[e] = False
    progress.terminated[e] = progress.truncated[e] = False
    progress.ticks[e] = progress.decisions[e] = 0
    progress.distance[e] = 0.0
    clear_decision(progress, e)


@part
def clear_decision(progress: Progress, e: int) -> None:
    """Set the sums over a decision's ticks to zero."""
    progress.decision_ticks[e] = 0
    progress.reward[e] = progress.speed[e] = 0.0
    for term in range(progress.terms.shape[1]):
        progress.terms[e, term] = 0.0
