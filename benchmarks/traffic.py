"""How fast highway-env's own traffic runs in kernels (`athrl_accelerate`), beside highway-env itself.

Both run the same frames of the same scenes, in turns, on one core: before every frame the accelerated road
gets the state of the slow one, then each is timed and their results are compared. A frame is `road.act()`
and `road.step(1 / 15)`. The accelerated road repeats each frame, as one is too short to be timed.
"""

from __future__ import annotations

import argparse
import copy
import json
import logging
import time
import warnings
from typing import Any, NamedTuple

import gymnasium
import highway_env  # noqa: F401  (importing it registers its environments)
import numpy as np
from athrl_accelerate import accelerate
from athrl_accelerate.parity import copy_state, difference
from athrl_accelerate.road import accelerate_road
from athrl_driving.maps import load_town
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import LaneIndex, Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle

DT = 1 / 15
RULES_EVERY = 7
"""Frames between two rounds of a regulated road's rules; frames are measured in multiples of it."""
REPEATS = 40
SIZES = (25, 50, 100, 200, 400, 1000)


class Result(NamedTuple):
    """Frames a CPU second of both, the greatest difference after one frame, and how many were measured."""

    slow: float
    fast: float
    parity: float
    frames: int

    @property
    def ratio(self) -> float:
        """How many times faster the accelerated road is."""
        return self.fast / self.slow


def highway_road(vehicles: int) -> Road:
    """Return the road of highway-v0 with so many vehicles besides the ego."""
    environment = gymnasium.make("highway-v0", config={"vehicles_count": vehicles}).unwrapped
    environment.reset(seed=0)
    return environment.road


def town_road(town: str, vehicles: int, regulated: bool) -> Road:
    """Return the lanes of a town with so many IDM vehicles on random routes."""
    network = RoadNetwork()
    network.graph = load_town(town).network.graph
    random = np.random.default_rng(0)
    road = (RegulatedRoad if regulated else Road)(network, np_random=random)
    indices = list(network.lanes_dict())
    lengths = np.array([network.get_lane(index).length for index in indices])
    places = np.zeros((0, 2))
    while len(road.vehicles) < vehicles:
        index = indices[random.choice(len(indices), p=lengths / lengths.sum())]
        along = random.uniform(0, network.get_lane(index).length)
        position = network.get_lane(index).position(along, 0)
        if len(places) and np.hypot(*(places - position).T).min() < 8.0:
            continue
        places = np.vstack([places, position])
        heading = network.get_lane(index).heading_at(along)
        vehicle = IDMVehicle(road, position, heading, speed=random.uniform(0, 10), target_speed=10.0)
        vehicle.randomize_behavior()
        vehicle.route = random_route(network, vehicle.lane_index, random)
        road.vehicles.append(vehicle)
    return road


def random_route(network: RoadNetwork, index: LaneIndex, random: np.random.Generator) -> list[LaneIndex]:
    """Return a route of random turns, with lane numbers: the rules raise IndexError for some without them."""
    route = [index]
    _, node, number = index
    while len(route) < 12 and network.graph.get(node):
        following = random.choice(list(network.graph[node]))
        number = min(number, len(network.graph[node][following]) - 1)
        route.append((node, following, number))
        node = following
    return route


def measure(plain: Road, frames: int) -> Result:
    """Run frames on a road and on its accelerated copy."""
    accelerated: Any = copy.deepcopy(plain)
    accelerate_road(accelerated)
    run(accelerated)  # compiles
    seconds, parity = np.zeros(2), 0.0
    for _ in range(frames):
        copy_state(plain, accelerated)
        rows = accelerated.table.rows
        kept, steps = [array.copy() for array in rows], getattr(plain, "steps", 0)
        repeats = 0.0
        for _ in range(REPEATS):
            for array, state in zip(rows, kept, strict=True):
                array[...] = state
            accelerated.steps = steps
            repeats += run(accelerated)
        seconds += run(plain), repeats / REPEATS
        parity = max(parity, difference(plain, accelerated))
    slow, fast = frames / seconds
    return Result(slow, fast, parity, frames)


def run(road: Road) -> float:
    """Run a frame; return the CPU seconds it took."""
    began = time.process_time()
    road.act()
    road.step(DT)
    return time.process_time() - began


def measure_steps(vehicles: int, steps: int) -> Result:
    """Step highway-v0 as an environment: 15 frames, the action, the observation and the reward."""
    config = {"vehicles_count": vehicles, "duration": 10_000}
    slow, fast = (gymnasium.make("highway-v0", config=config) for _ in range(2))
    seconds = np.zeros(2)
    accelerate(fast)
    for environment in (slow, fast):
        environment.reset(seed=0)
    for _ in range(steps):
        twin = copy.deepcopy(fast.unwrapped)
        for _ in range(REPEATS // 4):
            other = copy.deepcopy(twin)
            seconds[1] += step(other) / (REPEATS // 4)
        fast.step(1)
        seconds[0] += step(slow.unwrapped)
    return Result(*(steps / seconds), 0.0, steps)


def step(environment: gymnasium.Env) -> float:
    """Make a step; return the CPU seconds it took."""
    began = time.process_time()
    environment.step(1)
    return time.process_time() - began


def report(name: str, vehicles: int, result: Result) -> None:
    """Print a line of figures."""
    print(
        f"{name:<24} {vehicles:>5} vehicles {result.frames:>4} frames  highway-env {result.slow:9.3f}/s"
        f"  accelerated {result.fast:10.1f}/s  ratio {result.ratio:8.0f}  difference {result.parity:.1e}",
        flush=True,
    )


def scale() -> list[dict[str, float | str]]:
    """Measure from few vehicles to many; a frame of the slow road takes up to half a minute.

    A regulated road is measured over one round of its rules, the others over as few frames as tell enough.
    """
    found: list[dict[str, float | str]] = []
    for vehicles in SIZES:
        frames = max(2, min(3 * RULES_EVERY, 1000 // vehicles))
        for name, road, count in (
            ("highway-v0", highway_road(vehicles), frames),
            ("town04, no rules", town_road("town04", vehicles, regulated=False), frames),
            ("town04, rules", town_road("town04", vehicles, regulated=True), RULES_EVERY),
        ):
            result = measure(road, count)
            report(name, vehicles, result)
            found.append(
                {"scene": name, "vehicles": vehicles, "ratio": round(result.ratio, 1)} | result._asdict()
            )
    return found


def main() -> None:
    """Measure and print; the last line is one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scaling", action="store_true", help="also from 25 to 1,000 vehicles: ten minutes")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.getLogger("highway_env").setLevel(logging.ERROR)

    highway = measure(highway_road(100), 3 * RULES_EVERY)
    report("highway-v0", 100, highway)
    town = measure(town_road("town03", 100, regulated=True), 2 * RULES_EVERY)
    report("town03, rules", 100, town)
    whole = measure_steps(100, 3)
    report("highway-v0, whole steps", 100, whole)
    figures: dict[str, object] = {
        "town_regulated_100_ratio": round(town.ratio, 1),
        "highway_100_ratio": round(highway.ratio, 1),
        "highway_100_environment_step_ratio": round(whole.ratio, 1),
        "town_regulated_100_frames": round(town.fast, 1),
        "highway_100_frames": round(highway.fast, 1),
        "parity_one_step_max": max(town.parity, highway.parity),
    }
    if arguments.scaling:
        figures["scaling"] = scale()
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
