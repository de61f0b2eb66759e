"""The ego's route: lines and arcs along the lanes and across them, 12 waypoints 5 m apart, the ego's place.

Where the road forks, the way is that of a plan found by search, or turns are drawn at random.
"""

from athrl_driving.route.following import (
    KEPT_BEHIND,
    LANES_AHEAD,
    WAYPOINT_SPACING,
    WAYPOINTS_KNOWN,
    follow,
    has_arrived,
    heading_of_nearest_waypoint,
    lanes_ahead,
    route_pose,
    start_route,
    start_routes,
    waypoints,
)
from athrl_driving.route.search import plan_length, shortest_route
from athrl_driving.route.state import (
    CURVATURE,
    PLAN_ROWS,
    RouteState,
    dead_end_distance,
    environment_route,
    new_routes,
)
from athrl_driving.route.view import Route

__all__ = [
    "CURVATURE",
    "KEPT_BEHIND",
    "LANES_AHEAD",
    "PLAN_ROWS",
    "WAYPOINTS_KNOWN",
    "WAYPOINT_SPACING",
    "Route",
    "RouteState",
    "dead_end_distance",
    "environment_route",
    "follow",
    "has_arrived",
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
