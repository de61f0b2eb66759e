"""How well background traffic flows on the towns, and what a tick of it costs.

For every map: 100 vehicles, ten seeds, ten simulated minutes each, without an ego; bodies are checked
against each other at every tick by a test of their own. Free flow is each vehicle's desired speed, capped by
limits and curves on every metre of its path (`athrl_driving.traffic.flow`). CARLA's maps are read from
--carla where that is a folder. The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np
from athrl_driving.maps import Town, load_town
from athrl_driving.traffic.ego_columns import EGO_SIZE
from athrl_driving.traffic.flow import drive, measure_flow
from athrl_driving.traffic.spawn import place_vehicles
from athrl_driving.traffic.state import new_traffic

from benchmarks.maps import add_map_options, chosen_maps, told_in_one_line

TICKS_TIMED = 1000


def measure(town: Town, vehicles: int, seeds: int, minutes: float) -> dict[str, float]:
    """Return the mean or, where that is what counts, the worst over the seeds."""
    flows = [measure_flow(town, vehicles, seed, minutes) for seed in range(seeds)]
    return {
        "vehicles": vehicles,
        "share_of_free_flow": float(np.mean([flow.share_of_free_flow for flow in flows])),
        "worst_share": min(flow.share_of_free_flow for flow in flows),
        "mean_speed": float(np.mean([flow.mean_speed for flow in flows])),
        "longest_standstill": max(flow.longest_standstill for flow in flows),
        "colliding_pairs": sum(flow.colliding_pairs for flow in flows),
        "lane_changes": float(np.mean([flow.lane_changes for flow in flows])),
        "microseconds_a_tick": cost_of_a_tick(town, vehicles),
    }


def cost_of_a_tick(town: Town, vehicles: int) -> float:
    """Return CPU microseconds of this process; the least of five measurements, the machine is shared."""
    traffic = new_traffic(town, 1, vehicles)
    place_vehicles(traffic, 0, np.random.default_rng(0), None, 0.0, np.zeros(EGO_SIZE))
    drive(traffic, TICKS_TIMED)
    costs = []
    for _ in range(5):
        began = time.process_time()
        drive(traffic, TICKS_TIMED)
        costs.append(1e6 * (time.process_time() - began) / TICKS_TIMED)
    return min(costs)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_map_options(parser)
    parser.add_argument("--vehicles", type=int, nargs="+", default=[100])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--minutes", type=float, default=10.0, help="simulated minutes a seed")
    arguments = parser.parse_args()

    print(f"{'map':<24}{'vehicles':>9}{'speed':>8}{'of free':>9}{'worst':>7}{'still':>8}{'hits':>6}"
          f"{'changes':>9}{'us/tick':>9}{'us/vehicle':>12}")  # fmt: skip
    results: dict[str, list[dict[str, float]]] = {}
    for label, name in chosen_maps(arguments).items():
        town = load_town(name)
        for vehicles in arguments.vehicles:
            found = measure(town, vehicles, arguments.seeds, arguments.minutes)
            results.setdefault(label, []).append(found)
            cost = found["microseconds_a_tick"]
            print(f"{label:<24}{vehicles:>9}{found['mean_speed']:>8.2f}{found['share_of_free_flow']:>9.2f}"
                  f"{found['worst_share']:>7.2f}{found['longest_standstill']:>8.1f}"
                  f"{found['colliding_pairs']:>6}{found['lane_changes']:>9.0f}{cost:>9.1f}"
                  f"{cost / vehicles:>12.2f}", flush=True)  # fmt: skip
    print(json.dumps({"seeds": arguments.seeds, "minutes": arguments.minutes, "maps": results}))


if __name__ == "__main__":
    with told_in_one_line():
        main()
