"""The paper's case studies as settings of `TownEnv`: fixed places of town03 with seeded traffic there."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from athrl_driving.errors import DrivingError
from athrl_driving.maps import lane_pose
from athrl_driving.traffic.state import Traffic

SCENARIOS: dict[str, dict[str, Any]] = {
    # Into the two-lane ring from the south, past two exits, and out at the third, to the left.
    "athrl/Roundabout-v0": {
        "town": "town03",
        "start": ("Circle Road South", 1, 50.0),
        "destination": ("Circle Road West", 1, 60.0),
        "traffic_near": (0.0, 0.0, 150.0),
        "vehicles_count": 30,
        "episode_ticks": 1000,
    },
    # Along a straight street with a lane in each direction.
    "athrl/OncomingTraffic-v0": {
        "town": "town03",
        "start": ("Meadow Road", -1, 5.0),
        "destination": ("Meadow Road", -1, 195.0),
        "traffic_near": (-318.0, 0.0, 140.0),
        "vehicles_count": 15,
    },
    # Left at a crossing without lights, against two lanes of oncoming traffic.
    "athrl/UnprotectedLeft-v0": {
        "town": "town03",
        "start": ("Circle Road East", -1, 70.0),
        "destination": ("Garden Street", -1, 60.0),
        "traffic_near": (165.0, 0.0, 140.0),
        "vehicles_count": 30,
        "episode_ticks": 1000,
    },
}
"""The settings by environment id; all others are those of `TownEnv`.

An episode is long enough for a driver that gives way to arrive.
"""


def places_near(traffic: Traffic, x: float, y: float, radius: float) -> Traffic:
    """Return the same traffic with starting places only within `radius` metres of a point.

    What does not differ is shared. Raises ValueError in one line where there is no place.
    """
    rails, graph = traffic.rails, traffic.graph
    near = np.zeros(rails.start_link.size, dtype=np.bool_)
    for place, (link, position) in enumerate(zip(rails.start_link, rails.start_position, strict=True)):
        rows = rails.rows[rails.row_start[link] : rails.row_start[link + 1]]
        row = int(rows[np.searchsorted(rails.link_offset[rows], position, side="right") - 1])
        at_x, at_y, _ = lane_pose(graph, row, float(position - rails.link_offset[row]))
        near[place] = math.hypot(at_x - x, at_y - y) <= radius
    if not near.any():
        raise DrivingError(f"vehicles cannot start within {radius:g} m of ({x:g}, {y:g}): there is no lane")
    rails = rails._replace(start_link=rails.start_link[near], start_position=rails.start_position[near])
    return traffic._replace(rails=rails)
