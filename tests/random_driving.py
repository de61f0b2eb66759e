"""Drives on all maps with random settings, in kernels that check their indices, and writes a line for each.

    ATHRL_CHECK_INDICES=1 python -m tests.random_driving SEED

At the end it breaks the state of an environment and writes what the kernels say about that.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from random import Random
from typing import Any
from xml.etree import ElementTree

import gymnasium
import highway_env  # noqa: F401, registers its environments
from athrl_accelerate import accelerate
from athrl_driving import make_driver
from athrl_driving.envs import TownEnv, TownVectorEnv
from athrl_driving.errors import DrivingError
from athrl_driving.kernels.index_checks import CHECKS_INDICES, KernelIndexError
from athrl_driving.maps import TOWNS, load_town
from athrl_driving.scenarios import SCENARIOS
from athrl_driving.traffic.flow import measure_flow

from benchmarks.fuzz_maps.networks import loop

CARLA = Path(os.environ.get("ATHRL_TOWNS", Path(__file__).resolve().parents[2] / "shared" / "towns"))
VEHICLES = (0, 1, 40, 150)
SECONDS = 20.0


def settings_of(chance: Random, vehicles: int) -> dict[str, Any]:
    """Random settings of an environment."""
    side = chance.choice([16.0, 60.0, 400.0])
    return {
        "vehicles_count": vehicles,
        "action": {"type": chance.choice(["WaypointAction", "WaypointSetAction", "DirectAction"])},
        "destination": chance.choice([None, "random"]),
        "image_size": chance.choice([16, 32, 84]),
        "window_side": side,
        "ego_above_lower_edge": chance.uniform(0.0, side),
        "lidar_range": chance.choice([0.01, 5.0, 50.0, 1000.0]),
        "lidar_rays": chance.choice([4, 36, 720]),
        "ticks_per_decision": chance.choice([1, 4, 7]),
        "simulation_frequency": chance.choice([5, 10, 30]),
        "episode_ticks": chance.choice([20, 500]),
    }


def drive_vector(chance: Random, **arguments: Any) -> None:
    """Drive several environments by random actions."""
    threads = chance.choice([1, 2])
    envs = TownVectorEnv(num_envs=chance.choice([1, 8]), threads=threads, **arguments)
    envs.reset(seed=chance.randrange(1000))
    envs.action_space.seed(chance.randrange(1000))
    for _ in range(_decisions(envs.config)):
        envs.step(envs.action_space.sample())
    envs.close()


def drive_single(chance: Random, **arguments: Any) -> None:
    """Drive one environment, by the rule-based driver where the kind of action is its own."""
    env, seed = TownEnv(**arguments), chance.randrange(1000)
    driver = make_driver("rule-based") if env.config["action"] == {"type": "WaypointAction"} else None
    env.action_space.seed(seed)
    ended = True
    for _ in range(_decisions(env.config)):
        if ended:
            env.reset(seed=seed)
            if driver is not None:
                driver.reset(env, seed)
        action: Any = env.action_space.sample() if driver is None else driver.act(env)
        *_, terminated, truncated, _ = env.step(action)
        env.scene()
        ended = terminated or truncated
    env.close()


def _decisions(config: dict[str, Any]) -> int:
    return round(SECONDS * config["simulation_frequency"] / config["ticks_per_decision"])


def small_maps(folder: Path) -> list[Path]:
    """Write a few loops."""
    paths = [folder / f"loop{number}.xodr" for number in range(3)]
    for number, path in enumerate(paths):
        path.write_bytes(ElementTree.tostring(loop(Random(number)).get_element()))
    return paths


def drive_everywhere(chance: Random, folder: Path) -> None:
    """Drive on all maps and in all case studies; small maps are written to `folder`."""
    for name in [*TOWNS, "random-7", *map(str, sorted(CARLA.glob("*.xodr"))), *map(str, small_maps(folder))]:
        for vehicles in VEHICLES:
            for drive in (drive_vector, drive_single):
                settings = settings_of(chance, vehicles)
                try:
                    drive(chance, config=settings, map=name)
                except DrivingError as error:
                    if "room for" not in str(error):
                        raise
                print(Path(name).name, settings, flush=True)
        measure_flow(load_town(name), 5, 0, 0.5)
    for scenario in SCENARIOS:
        drive_vector(chance, scenario=scenario)
        drive_single(chance, scenario=scenario)
        print(scenario, flush=True)


def drive_highway_env(chance: Random) -> None:
    """Drive in highway-env's own environments, accelerated."""
    for name in ("highway-v0", "merge-v0", "roundabout-v0", "intersection-v0", "two-way-v0", "exit-v0"):
        env = accelerate(gymnasium.make(name, config={"vehicles_count": chance.choice([1, 40])}))
        env.reset(seed=chance.randrange(1000))
        env.action_space.seed(0)
        for _ in range(20):
            *_, terminated, truncated, _ = env.step(env.action_space.sample())
            if terminated or truncated:
                env.reset()
        print(name, flush=True)


def break_and_drive() -> None:
    """Let a vehicle be on a lane that does not exist."""
    env = TownEnv({"vehicles_count": 5})
    env.reset(seed=0)
    env.episodes.state.traffic.background.lane[0, 2] = -1
    try:
        env.step(None)
    except KernelIndexError as error:
        print(error)


if __name__ == "__main__":
    assert CHECKS_INDICES, "set ATHRL_CHECK_INDICES=1"
    chance = Random(int(sys.argv[1]))
    with tempfile.TemporaryDirectory() as folder:
        drive_everywhere(chance, Path(folder))
    drive_highway_env(chance)
    break_and_drive()
