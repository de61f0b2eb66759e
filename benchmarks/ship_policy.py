"""Put a run's policy into the package, with a card that says how it was trained and what it scores.

    python -m benchmarks.ship_policy runs/town03 town03 --purpose "drives in town03"

It is scored on episodes of seeds that no run trains or evaluates on, beside the rule-based driver, in each of
the run's towns. Afterwards `athrl evaluate --policy NAME` and `athrl watch --policy NAME` know it.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tomllib
from pathlib import Path

from athrl_evaluator.policies.shipped import FOLDER, ship

SCORES = ("return_mean", "return_ci95", "collision_rate", "off_lane_rate", "full_episode_rate", "speed_mps")

LIMITS = [
    "driven in no other towns than those named: in bends that it has not seen it leaves the lane",
    "100 background vehicles that keep the rules, no pedestrians, no bad weather; not for real cars",
]


def scored(policy: str, town: str, episodes: int, seed: int) -> dict[str, float]:
    """Scores of a policy or driver in a town by `athrl evaluate`."""
    command = [sys.executable, "-m", "athrl", "evaluate", "--policy", policy, "--town", town, "--json"]
    command += ["--episodes", str(episodes), "--seed", str(seed)]
    said = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    scores = json.loads(said.splitlines()[-1])
    return {name: round(scores[name], 4) for name in SCORES}


def present_commit() -> str:
    """The checked out commit, shortened; empty outside a repository."""
    command = ["git", "rev-parse", "--short", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


def main() -> None:
    """Score a policy and ship it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path, help="folder of a finished run")
    parser.add_argument("name", help="by which the policy will be called")
    parser.add_argument("--purpose", required=True, help="what it is for, in one line")
    parser.add_argument("--episodes", type=int, default=300)
    parser.add_argument("--seed", type=int, default=700_000)
    parser.add_argument("--folder", type=Path, default=FOLDER, help="of the policies")
    here = f"{len(os.sched_getaffinity(0))} cores, {platform.machine()}"
    parser.add_argument("--machine", default=here, help="it was trained on, in a few words")
    parser.add_argument("--commit", help="of the program that trained it; by default the present one")
    arguments = parser.parse_args()
    settings = tomllib.loads((arguments.run / "run.toml").read_text())
    policy = arguments.run / "policies" / "latest.onnx"
    told = json.loads(policy.with_suffix(".json").read_bytes())
    towns = list(settings["environment"]["towns"])
    scores = {}
    for town in towns:
        for driver in (str(policy), "rule-based"):
            name = "policy" if driver != "rule-based" else driver
            key = name if len(towns) == 1 else f"{name} in {town}"
            scores[key] = scored(driver, town, arguments.episodes, arguments.seed)
            print(key, scores[key], flush=True)
    shipped = ship(
        policy.read_bytes(),
        arguments.name,
        arguments.folder,
        purpose=arguments.purpose,
        trained=f"athrl train, {told['updates']} updates, {arguments.machine}, "
        f"seed {settings['run']['seed']}",
        commit=arguments.commit or present_commit(),
        decisions=int(told["environment_steps"]),
        town=", ".join(towns),
        scores=scores,
        limits=[*LIMITS, f"scores are of {arguments.episodes} episodes from seed {arguments.seed} on"],
    )
    print(f"shipped as {shipped}")


if __name__ == "__main__":
    main()
