"""How fast the town steps, beside a stock highway-env environment with as many vehicles, in one process.

Both are driven with the middle of their action spaces and, as they share the machine's moods, in turns.
A frame is one simulated tick: the town's is 0.1 s long, and its observation is made once in four.
"""

from __future__ import annotations

import argparse
import json
import time

import athrl_driving  # noqa: F401  (importing it registers the towns)
import gymnasium
import numpy as np

TOWN, STOCK = "athrl/Town03-v0", "highway-v0"


class Lap:
    """Steps one environment for a while and counts frames and CPU seconds of this process."""

    def __init__(self, environment: gymnasium.Env, action: object, frames_a_step: int) -> None:
        self.environment = environment
        self.action = action
        self.frames_a_step = frames_a_step
        self.frames = 0
        self.seconds = 0.0
        self.seed = 0
        environment.reset(seed=self.seed)
        environment.step(action)  # compiles, draws, fills caches

    def run(self, seconds: float) -> None:
        """Step for about `seconds`; resets are made but not measured."""
        until = time.process_time() + seconds
        while time.process_time() < until:
            began = time.process_time()
            _, _, terminated, truncated, _ = self.environment.step(self.action)
            self.seconds += time.process_time() - began
            self.frames += self.frames_a_step
            if terminated or truncated:
                self.seed += 1
                self.environment.reset(seed=self.seed)

    @property
    def rate(self) -> float:
        """Frames a CPU second."""
        return self.frames / self.seconds


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=30.0, help="CPU seconds in all")
    arguments = parser.parse_args()

    town = gymnasium.make(TOWN, config={"vehicles_count": arguments.vehicles})
    stock = gymnasium.make(STOCK, config={"vehicles_count": arguments.vehicles, "duration": 1000})
    frequency = stock.unwrapped.config["simulation_frequency"] // stock.unwrapped.config["policy_frequency"]
    laps = [Lap(town, np.zeros(2, np.float32), 4), Lap(stock, 1, frequency)]
    turns = 6
    for _ in range(turns):
        for lap in laps:
            lap.run(arguments.seconds / turns / len(laps))
    ours, theirs = (lap.rate for lap in laps)
    print(f"{TOWN} {ours:.0f} frames/s, {STOCK} {theirs:.1f} frames/s, {arguments.vehicles} vehicles each")
    print(
        json.dumps(
            {
                "vehicles": arguments.vehicles,
                "town_frames": ours,
                "stock_frames": theirs,
                "ratio": ours / theirs,
            }
        )
    )


if __name__ == "__main__":
    main()
