"""One tick of an episode, compiled."""

from athrl_driving.episode.collision_checks import collide, time_to_collision
from athrl_driving.episode.ego import EGO_WHEELBASE, STEERING, control_ego, move_ego
from athrl_driving.episode.state import DriveSettings, Progress, Views
from athrl_driving.kernels.compilation import part
from athrl_driving.maps.geometry import lane_elevation, lane_project
from athrl_driving.metrics import NO_COLLISION, TickRecord, note_tick
from athrl_driving.reward import add_reward_terms, has_left_lane
from athrl_driving.route import (
    RouteState,
    follow,
    has_arrived,
    has_ended,
    heading_of_nearest_waypoint,
    lanes_ahead,
)
from athrl_driving.traffic.ego_columns import ELEVATION, HEADING, SPEED, X, Y
from athrl_driving.traffic.signals import red_light
from athrl_driving.traffic.tick import advance


@part
def tick(views: Views, settings: DriveSettings, progress: Progress, e: int) -> None:
    """Drive environment `e`, whose own traffic, route and metrics are in `views`, for one tick.

    Traffic sees where the ego was at the tick's beginning.
    """
    traffic, route, graph, interval = views.traffic, views.route, views.traffic.graph, settings.interval
    ego, control, path = progress.ego[e], progress.control[e], progress.path[e]
    position = route.position[0]
    control_ego(ego, control, settings.speed_gain, interval)
    advance(traffic, ego, path, interval)
    vehicles = traffic.background.x.shape[0]  # the ego comes after them
    line = float(traffic.right_of_way.line_distance[vehicles])
    ahead = int(traffic.right_of_way.ahead[vehicles])
    move_ego(ego, control, progress.collision[e] != NO_COLLISION, EGO_WHEELBASE, interval)
    follow(graph, route, ego[X], ego[Y])
    lanes_ahead(graph, route, path)
    ego[ELEVATION] = lane_elevation(graph, path[0], lane_project(graph, path[0], ego[X], ego[Y])[0])
    touched = collide(traffic.background, progress.obstacles[e], progress.obstacle_count[e], ego)
    if touched != NO_COLLISION:
        progress.collision[e] = touched
    _count_tick(settings, progress, e, route)
    driven = route.position[0] - position
    record = TickRecord(
        ego[SPEED], ego[HEADING], driven, route.lateral[0],
        time_to_collision(traffic.background, ego), 0.0 <= line < driven and red_light(traffic, ahead),
        touched, progress.off_lane[e], progress.arrived[e] or progress.route_end[e], interval,
    )  # fmt: skip
    note_tick(views.metrics, record)


@part
def _count_tick(settings: DriveSettings, progress: Progress, e: int, route: RouteState) -> None:
    """Add the tick to the sums of the decision and the episode, and check whether the episode has ended."""
    ego, terms = progress.ego[e], progress.terms[e]
    collided, lateral = progress.collision[e] != NO_COLLISION, route.lateral[0]
    error = ego[HEADING] - heading_of_nearest_waypoint(route)
    add_reward_terms(terms, collided, ego[SPEED], error, lateral, progress.control[e, STEERING])
    reward = 0.0
    for term in range(terms.shape[0]):
        reward += terms[term]
    progress.reward[e] = reward
    ticks = progress.decision_ticks[e]
    progress.speed[e] = (progress.speed[e] * ticks + ego[SPEED]) / (ticks + 1)
    progress.decision_ticks[e] = ticks + 1
    progress.distance[e] += ego[SPEED] * settings.interval
    progress.ticks[e] += 1
    left, arrived = has_left_lane(lateral), has_arrived(route)
    progress.off_lane[e], progress.arrived[e] = left, arrived
    ended = collided or left or arrived
    progress.terminated[e] = ended
    # Beyond the map's edge the drive would go on: that is where the map ends, not the task.
    progress.route_end[e] = not ended and has_ended(route)
    time_is_up = progress.ticks[e] >= settings.episode_ticks
    progress.truncated[e] = progress.route_end[e] or (not ended and time_is_up)
