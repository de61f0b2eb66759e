"""The paper's case studies as settings of `TownEnv`: fixed places of town03 with seeded traffic there."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from athrl_spaces import CASE_STUDIES

from athrl_driving.errors import DrivingError
from athrl_driving.maps import lane_pose
from athrl_driving.traffic.state import Traffic

SCENARIOS: dict[str, dict[str, Any]] = {
    # Into the two-lane ring from the south, past two exits, and out at the third, on the left.
    CASE_STUDIES["roundabout"]: {
        "town": "town03",
        "start": ("Circle Road South", 1, 50.0),
        "destination": ("Circle Road West", 1, 60.0),
        "traffic_near": (0.0, 0.0, 150.0),
        "vehicles_count": 30,
        "episode_ticks": 1000,
    },
    # Along a straight street with a lane in each direction.
    CASE_STUDIES["oncoming-traffic"]: {
        "town": "town03",
        "start": ("Meadow Road", -1, 5.0),
        "destination": ("Meadow Road", -1, 195.0),
        "traffic_near": (-318.0, 0.0, 140.0),
        "vehicles_count": 15,
    },
    # Left at a crossing without lights, against two lanes of oncoming traffic.
    CASE_STUDIES["unprotected-left"]: {
        "town": "town03",
        "start": ("Circle Road East", -1, 70.0),
        "destination": ("Garden Street", -1, 60.0),
        "traffic_near": (165.0, 0.0, 140.0),
        "vehicles_count": 30,
        "episode_ticks": 1000,
    },
}
"""The settings by environment id; all other settings are the defaults of `TownEnv`.

An episode is long enough for a driver that gives way to reach the destination.
"""


def places_near(traffic: Traffic, x: float, y: float, radius: float) -> Traffic:
    """Return the same traffic with starting places only within `radius` metres of a point.

    What does not differ is shared. Raises ValueError in one line where there is no place.
    """
    lane_links, graph = traffic.lane_links, traffic.graph
    near = np.zeros(lane_links.start_link.size, dtype=np.bool_)
    for place, (link, position) in enumerate(
        zip(lane_links.start_link, lane_links.start_position, strict=True)
    ):
        lanes = lane_links.lanes[lane_links.lane_start[link] : lane_links.lane_start[link + 1]]
        lane = int(lanes[np.searchsorted(lane_links.link_offset[lanes], position, side="right") - 1])
        at_x, at_y, _ = lane_pose(graph, lane, float(position - lane_links.link_offset[lane]))
        near[place] = math.hypot(at_x - x, at_y - y) <= radius
    if not near.any():
        raise DrivingError(f"vehicles cannot start within {radius:g} m of ({x:g}, {y:g}): there is no lane")
    lane_links = lane_links._replace(
        start_link=lane_links.start_link[near], start_position=lane_links.start_position[near]
    )
    return traffic._replace(lane_links=lane_links)
