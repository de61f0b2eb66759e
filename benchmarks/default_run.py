"""Results of `make train` with several seeds, on held-out episodes.

    python -m benchmarks.default_run --seeds 1 2 3 --out runs/default-run.json

trains the default run with each seed, one after the other, through the real services, and scores the last
policy and the rule-based driver on 300 episodes. A finished run is only scored, an interrupted one is
resumed. The last line is one JSON object, which is also written to `--out`; the machine should be idle
otherwise.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from athrl.ports import free_address
from athrl.runs import holds_run
from athrl.study.runs import train_words

from benchmarks.ship_policy import scored

TOWN = "town03"
MEANS = ("return_mean", "collision_rate", "off_lane_rate", "full_episode_rate")


def trained(name: str, seed: int, arguments: argparse.Namespace) -> tuple[Path, float | None]:
    """The policy of a run, and the seconds that training took if it was done now and in one piece."""
    run = arguments.folder / name
    policy, finished = run / "policies" / "latest.onnx", run / "evaluation.json"
    if finished.exists():
        return policy, None
    interrupted = holds_run(run)
    words = train_words(run, [f"run.seed={seed}", *arguments.set], address=free_address())
    began = time.monotonic()
    subprocess.run([sys.executable, "-m", "athrl", *words], check=True, stdin=subprocess.DEVNULL)
    return policy, None if interrupted else round(time.monotonic() - began, 1)


def main() -> None:
    """Train, score, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--episodes", type=int, default=300)
    parser.add_argument("--first-seed", type=int, default=700_000, help="of the scored episodes")
    parser.add_argument("--name", default="default", help="of the runs, in front of their seeds")
    parser.add_argument("--folder", type=Path, default=Path("runs"), help="of the runs")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, default=Path("runs/default-run.json"))
    arguments = parser.parse_args()
    runs: dict[int, dict[str, Any]] = {}
    for seed in arguments.seeds:
        policy, seconds = trained(f"{arguments.name}-{seed}", seed, arguments)
        told = json.loads(policy.with_suffix(".json").read_bytes())
        runs[seed] = {
            "decisions": told["environment_steps"],
            "updates": told["updates"],
            "seconds": seconds,
            **scored(str(policy), TOWN, arguments.episodes, arguments.first_seed),
        }
        print(f"seed {seed}: {runs[seed]}", flush=True)
    rule_based = scored("rule-based", TOWN, arguments.episodes, arguments.first_seed)
    means = {name: round(statistics.mean(run[name] for run in runs.values()), 4) for name in MEANS}
    facts = {
        "town": TOWN,
        "episodes": arguments.episodes,
        "first_seed": arguments.first_seed,
        "cores": len(os.sched_getaffinity(0)),
        "settings": arguments.set,
        "runs": runs,
        "mean": means,
        "return_of_rule_based": round(means["return_mean"] / rule_based["return_mean"], 4),
        "rule_based": rule_based,
    }
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(facts, indent=1) + "\n")
    print(json.dumps(facts))


if __name__ == "__main__":
    main()
