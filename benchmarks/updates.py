"""How many updates a second training does on the CPU and on a GPU: where a GPU pays, and what it costs there.

The learner's own: sequences sampled from its replay, both levels of the default planner trained on them, and
what they report read. A larger planner beside it, since a small one keeps no GPU busy.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from itertools import product
from pathlib import Path
from typing import Any

import torch
from athrl_learner import translation
from athrl_protocol import RunFile, read_run_file

from benchmarks.checkpoint import filled

TURNS = 3
WARM_UP = 5  # updates
TRANSITIONS = 20_000  # in the replay
PLANNERS = {
    "default": [],
    "large": ["planner.hidden_features=512", "planner.recurrent_features=256"],
}


class Training:
    """A learner that trains on a full replay, and how many updates a second it does."""

    def __init__(self, device: str, planner: str, batch: int, threads: int, folder: Path) -> None:
        self.device, self.planner, self.batch, self.threads = device, planner, batch, threads
        self.rates: list[float] = []
        run_file = self._run_file()
        self._agent = translation.make_agent(run_file)
        self._store = filled(run_file, folder, self._agent)
        self._run(WARM_UP)

    def turn(self, seconds: float) -> None:
        """Train for so long."""
        began, updates = time.perf_counter(), 0
        while time.perf_counter() - began < seconds:
            self._run(1)
            updates += 1
        self.rates.append(updates / (time.perf_counter() - began))

    def close(self) -> None:
        """Let go of the log."""
        self._store.log.close()

    def figures(self) -> dict[str, Any]:
        """What it was and what came of it."""
        return {
            "device": self.device,
            "threads": self.threads,
            "planner": self.planner,
            "batch": self.batch,
            "updates_per_second": round(statistics.median(self.rates), 1),
            "sequences_per_second": round(self.batch * statistics.median(self.rates)),
        }

    def _run(self, updates: int) -> None:
        torch.set_num_threads(self.threads)
        for _ in range(updates):
            self._agent.update(self._store.replay.sample(self.batch))

    def _run_file(self) -> RunFile:
        return read_run_file(
            None,
            [
                f"learner.device={self.device}",
                f"learner.batch={self.batch}",
                f"replay.capacity={TRANSITIONS}",
                "learner.samples_per_insert=0.001",
                *PLANNERS[self.planner],
            ],
        )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batches", type=int, nargs="+", default=[16, 64, 256])
    parser.add_argument("--threads", type=int, nargs="+", default=[1], help="of the CPU")
    parser.add_argument("--seconds", type=float, default=2.0, help="of each turn")
    arguments = parser.parse_args()
    places = [("cpu", threads) for threads in arguments.threads]
    if torch.cuda.is_available():
        places.append(("cuda", 1))
    rows = []
    for planner, batch in product(PLANNERS, arguments.batches):
        rows += _beside_each_other(places, planner, batch, arguments.seconds)
    for row in rows:
        print("  ".join(f"{name} {value}" for name, value in row.items()))
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    print(json.dumps({"torch": torch.__version__, "gpu": gpu, "rows": rows}))


def _beside_each_other(
    places: list[tuple[str, int]], planner: str, batch: int, seconds: float
) -> list[dict[str, Any]]:
    """Train in all places in turns; `ratio` is to the first one."""
    with tempfile.TemporaryDirectory() as name:
        trainings = [
            Training(device, planner, batch, threads, Path(name) / f"{device}-{threads}")
            for device, threads in places
        ]
        for _ in range(TURNS):
            for training in trainings:
                training.turn(seconds)
        for training in trainings:
            training.close()
    rows = [training.figures() for training in trainings]
    return [
        {**row, "ratio": round(row["updates_per_second"] / rows[0]["updates_per_second"], 2)} for row in rows
    ]


if __name__ == "__main__":
    main()
