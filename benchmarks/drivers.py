"""How many episodes a driver completes among 100 vehicles, on every map.

Each seed is one episode of 50 s on random turns, as a policy drives it: through a target speed and a
waypoint. It is completed without a collision (by any vehicle's fault) and without leaving the lane. CARLA's
maps are read from --carla where that is a folder. The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence

import numpy as np
from athrl_driving import make_driver
from athrl_driving.drivers import DRIVERS
from athrl_driving.envs import TownVectorEnv

from benchmarks.maps import add_map_options, chosen_maps, told_in_one_line


def drive(town: str, driver_name: str, vehicles: int, seeds: Sequence[int]) -> dict[str, object]:
    """Drive one episode a seed, all in one batch; return shares, means and the seeds that ended early."""
    batch = TownVectorEnv(len(seeds), config={"town": town, "vehicles_count": vehicles})
    batch.reset(seed=list(seeds))
    drivers = [make_driver(driver_name) for _ in seeds]
    for e, driver in enumerate(drivers):
        driver.reset(batch.environment(e), seeds[e])
    driving = np.ones(len(seeds), np.bool_)
    actions = np.zeros((len(seeds), 2), np.float32)
    while driving.any():
        for e in np.flatnonzero(driving).tolist():
            actions[e] = drivers[e].act(batch.environment(e))
        _, terminated, truncated, _ = batch.step_environments(actions, driving)
        driving &= ~(terminated | truncated)
    state = batch.episodes.state.progress
    collided, left = state.collision != 0, state.off_lane.copy()
    seconds = state.ticks * batch.episodes.state.settings.interval
    batch.close()
    return {
        "episodes": len(seeds),
        "without_collision": float(np.mean(~collided)),
        "without_lane_exit": float(np.mean(~left)),
        "without_either": float(np.mean(~(collided | left))),
        "mean_speed": float(state.distance.sum() / seconds.sum()),
        "collision_seeds": np.asarray(seeds)[collided].tolist(),
        "lane_exit_seeds": np.asarray(seeds)[left].tolist(),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_map_options(parser)
    parser.add_argument("--driver", choices=list(DRIVERS), default="rule-based")
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=40, help="episodes a map")
    parser.add_argument("--first-seed", type=int, default=0)
    arguments = parser.parse_args()

    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    print(f"{'map':<16}{'episodes':>9}{'no collision':>14}{'no lane exit':>14}{'neither':>9}{'m/s':>7}")
    results = {}
    for label, town in chosen_maps(arguments).items():
        found = results[label] = drive(town, arguments.driver, arguments.vehicles, seeds)
        print(f"{label:<16}{found['episodes']:>9}{found['without_collision']:>14.1%}"
              f"{found['without_lane_exit']:>14.1%}{found['without_either']:>9.1%}{found['mean_speed']:>7.2f}",
              flush=True)  # fmt: skip
    print(json.dumps({"driver": arguments.driver, "vehicles": arguments.vehicles, "maps": results}))


if __name__ == "__main__":
    with told_in_one_line():
        main()
