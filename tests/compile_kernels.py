"""Compile what tests call, for `make test`: in one process, as most kernels are made of the same parts.

A process that has compiled the traffic for one kernel has it for all others. Workers that run tests beside
each other would each compile it once more.
"""

import runpy
from pathlib import Path

import gymnasium
import numpy as np
from athrl_accelerate import accelerate
from athrl_driving.maps import load_town
from athrl_driving.traffic.ego_columns import EGO_SIZE
from athrl_driving.traffic.flow import measure_flow
from athrl_driving.traffic.spawn import place_vehicles
from athrl_driving.traffic.state import new_traffic
from athrl_driving.traffic.tick import tick

from driving.tests.test_perception import moment

runpy.run_path(str(Path(__file__).parents[1] / "deploy/warm_up.py"))

town = load_town("town04")
measure_flow(town, vehicles=1, seed=0, minutes=0.01)
traffic = new_traffic(town, 1, 1)
place_vehicles(traffic, 0, np.random.default_rng(0), None, 0.0, np.zeros(EGO_SIZE))
moment(seed=0).image()
tick(traffic, 0, np.zeros(EGO_SIZE), np.array([-1]), 0.1)
accelerate(gymnasium.make("highway-v0"))
