"""How fast environments step, one and a batch of 64, beside stock highway-env with as many vehicles.

A step is one simulated tick of town03 with 100 vehicles, bird's eye view and lidar included. All are driven
with the middle of their action spaces, in turns, as the speed of the machine varies. One environment and
its peers are measured in CPU seconds of one core, without resets and with them; a batch in seconds of the
clock on two cores, resets included, as it starts its next episodes itself.

The peers are stock highway-env: highway-v0 as it is, and highway-v0 with an image of about the same content,
an occupancy grid of 32 x 32 cells with the road in it; both observe every frame, as the town does.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable

import athrl_driving  # noqa: F401  (importing it registers the towns)
import gymnasium
import numpy as np

TOWN, STOCK = "athrl/Town03-v0", "highway-v0"
GRID = {
    "type": "OccupancyGrid",
    "features": ["presence", "on_road"],
    "grid_size": [[-12, 20], [-16, 16]],
    "grid_step": [1, 1],
    "align_to_vehicle_axes": True,
}
BATCH = 64
TURNS = 5


class Lap:
    """Steps one environment and counts frames and CPU seconds of this process."""

    def __init__(self, environment: gymnasium.Env, action: object) -> None:
        self.environment = environment
        self.action = action
        self.frames = 0
        self.stepping = 0.0
        self.resetting = 0.0
        self.seed = 0
        environment.reset(seed=self.seed)
        environment.step(action)  # compiles, draws, fills caches

    def run(self, seconds: float) -> None:
        """Step for about `seconds` of this process."""
        until = time.process_time() + seconds
        while (began := time.process_time()) < until:
            ended = False
            while not ended and time.process_time() < until:
                _, _, terminated, truncated, _ = self.environment.step(self.action)
                self.frames += 1
                ended = terminated or truncated
            stepped = time.process_time()
            self.seed += 1
            self.environment.reset(seed=self.seed)
            self.stepping += stepped - began
            self.resetting += time.process_time() - stepped

    @property
    def rate(self) -> float:
        """Frames a CPU second, resets left out."""
        return self.frames / self.stepping

    @property
    def rate_with_resets(self) -> float:
        """Frames a CPU second of stepping and resetting."""
        return self.frames / (self.stepping + self.resetting)


class BatchLap:
    """Steps a batch of environments by the clock."""

    def __init__(self, vehicles: int, threads: int) -> None:
        config = {"vehicles_count": vehicles, "ticks_per_decision": 1}
        self.environments = gymnasium.make_vec(
            TOWN, num_envs=BATCH, vectorization_mode="vector_entry_point", config=config, threads=threads
        )
        self.actions = np.zeros((BATCH, 2), np.float32)
        self.rates: list[float] = []
        self.environments.reset(seed=0)
        self.environments.step(self.actions)

    def run(self, seconds: float) -> None:
        """Step for about `seconds`."""
        began, steps = time.perf_counter(), 0
        while time.perf_counter() - began < seconds:
            self.environments.step(self.actions)
            steps += BATCH
        self.rates.append(steps / (time.perf_counter() - began))

    @property
    def rate(self) -> float:
        """Steps a second, the median of the turns."""
        return statistics.median(self.rates)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=30.0, help="of measuring in all")
    arguments = parser.parse_args()
    figures = measure(arguments.vehicles, arguments.seconds / TURNS / 5)
    for name, value in figures.items():
        print(f"{name:42} {value:12,.1f}")
    print(json.dumps({"vehicles": arguments.vehicles, **figures}))


def measure(vehicles: int, seconds: float) -> dict[str, float]:
    """Run all laps in turns, `seconds` each, and return rates (1/s) and ratios."""
    town = Lap(_town(vehicles), np.zeros(2, np.float32))
    stock = Lap(_stock(vehicles), 1)
    grid = Lap(_stock(vehicles, observation=GRID), 1)
    one_thread, two_threads = BatchLap(vehicles, 1), BatchLap(vehicles, 2)
    laps: list[Callable[[float], None]] = [lap.run for lap in (town, stock, grid, one_thread, two_threads)]
    for _ in range(TURNS):
        for run in laps:
            run(seconds)
    return {
        "env_steps_per_second_core": town.rate,
        "env_steps_per_second_core_with_resets": town.rate_with_resets,
        "batch64_steps_per_second_one_core": one_thread.rate,
        "batch64_steps_per_second_two_cores": two_threads.rate,
        "stock_highway_frames_per_second_core": stock.rate,
        "stock_highway_grid_frames_per_second_core": grid.rate,
        "ratio_to_stock_highway": town.rate / stock.rate,
        "ratio_to_stock_highway_grid": town.rate / grid.rate,
    }


def _town(vehicles: int) -> gymnasium.Env:
    return gymnasium.make(TOWN, config={"vehicles_count": vehicles, "ticks_per_decision": 1})


def _stock(vehicles: int, **config: object) -> gymnasium.Env:
    config = {"vehicles_count": vehicles, "duration": 1000, "policy_frequency": 15, **config}
    return gymnasium.make(STOCK, config=config)


if __name__ == "__main__":
    main()
