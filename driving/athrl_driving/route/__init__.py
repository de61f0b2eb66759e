"""The ego's route: lines and arcs along and across lanes, 12 waypoints 5 m apart, the ego's position.

Where the road forks, the route follows a plan found by search, or turns are drawn at random, off the map only
where there is no other way. There the route ends.
"""

from athrl_driving.route.search import plan_length, shortest_route
from athrl_driving.route.state import (
    CURVATURE,
    PLAN_LANES,
    RouteState,
    dead_end_distance,
    environment_route,
    new_routes,
)
from athrl_driving.route.tracking import (
    KEPT_BEHIND,
    LANES_AHEAD,
    WAYPOINT_SPACING,
    WAYPOINTS_KNOWN,
    follow,
    has_arrived,
    has_ended,
    heading_of_nearest_waypoint,
    lanes_ahead,
    route_pose,
    start_route,
    start_routes,
    waypoints,
)
from athrl_driving.route.view import Route

__all__ = [
    "CURVATURE",
    "KEPT_BEHIND",
    "LANES_AHEAD",
    "PLAN_LANES",
    "WAYPOINTS_KNOWN",
    "WAYPOINT_SPACING",
    "Route",
    "RouteState",
    "dead_end_distance",
    "environment_route",
    "follow",
    "has_arrived",
    "has_ended",
    "heading_of_nearest_waypoint",
    "lanes_ahead",
    "new_routes",
    "plan_length",
    "route_pose",
    "shortest_route",
    "start_route",
    "start_routes",
    "waypoints",
]
