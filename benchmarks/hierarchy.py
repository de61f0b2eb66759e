"""What makes the levels of atHRL differ, and whether the intention then matters.

    python -m benchmarks.hierarchy --decisions 300000

trains each variant with each seed, `athrl train --serial` on one core, as many at once as there are cores,
and then intervenes: the policy drives held-out episodes free and with its intention forced to 0 (left), 1
(straight on) and 2 (right), and on what it sees while it drives free it is asked how far the waypoint and the
target speed turn with the intention. `--out` gets a VARIANT-SEED.json for each; one that is there already is
not measured again. The last line printed is all of them as one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from athrl.ports import free_address
from athrl.study.runs import train_words
from athrl_driving.policy import OnnxPolicy
from athrl_evaluator.evaluate import EvaluationSettings, evaluate_driver

from benchmarks.failures import begun

VARIANTS: dict[str, list[str]] = {
    "hddpg": ["planner.kind=hddpg"],
    "default": [],
    "near-route": ["planner.trajectory_view=near route"],
    "both-views": ["planner.trajectory_view=near route", "planner.intention_view=far route"],
    "every-5": ["planner.intention_every=5"],
    "progress": ["planner.intention_reward=progress", "planner.intention_target=experience"],
    "all": [
        "planner.trajectory_view=near route",
        "planner.intention_view=far route",
        "planner.intention_every=5",
        "planner.intention_reward=progress",
        "planner.intention_target=experience",
    ],
}
FORCED = {"left": 0.0, "straight on": 1.0, "right": 2.0}
SCORES = ("return_mean", "return_ci95", "collision_rate", "off_lane_rate", "full_episode_rate")
FIRST_SEED = 700_000
ASKED_EPISODES = 20


def trained(variant: str, seed: int, decisions: int, out: Path) -> Path:
    """Train, unless that has been done; return the file of the policy."""
    name = f"{variant}-{seed}"
    policy = out / "runs" / name / "policies" / "latest.onnx"
    settings = [
        "serial.enabled=true",
        f"run.seed={seed}",
        f"run.environment_steps={decisions}",
        "learner.precision=bfloat16",
        "learner.checkpoint_seconds=1000000",
        "evaluator.seconds_between=1000000",
        "evaluator.final_episodes=2",
        *VARIANTS[variant],
    ]
    words = train_words(out / "runs" / name, settings, address=free_address())
    with (out / f"{name}.log").open("w") as log:
        subprocess.run(
            [sys.executable, "-m", "athrl", *words],
            check=True,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
    return policy


def intervened(policy: Path, episodes: int) -> dict[str, Any]:
    """Scores of a policy, free and forced, and how its waypoint turns with the intention."""
    facts: dict[str, Any] = {"free": _scores(policy, episodes, ())}
    if OnnxPolicy.load(policy).description.planner == "athrl":
        for name, value in FORCED.items():
            facts[f"forced {name}"] = _scores(policy, episodes, (f"intention={value}",))
        facts |= _asked(OnnxPolicy.load(policy))
    return facts


def _scores(policy: Path, episodes: int, forced: tuple[str, ...]) -> dict[str, float]:
    settings = EvaluationSettings(episodes=episodes, seed=FIRST_SEED, forced=forced)
    scores = evaluate_driver(policy, settings).as_dict()
    return {name: round(scores[name], 4) for name in SCORES}


def _asked(policy: OnnxPolicy) -> dict[str, float]:
    """What `left` and `right` change in the decisions of episodes that are driven free."""
    batch = begun(policy, "town03", list(range(FIRST_SEED, FIRST_SEED + ASKED_EPISODES)))
    states, driving = policy.initial_states(ASKED_EPISODES), np.ones(ASKED_EPISODES, np.bool_)
    turned: list[np.ndarray] = []
    intentions: list[np.ndarray] = []
    while driving.any():
        seen = (batch.images, batch.motion, states)
        left, right = (
            policy.step(*seen, forced={"intention": np.full((ASKED_EPISODES, 1), FORCED[way], np.float32)})
            for way in ("left", "right")
        )
        step = policy.step(*seen)
        turned.append(np.abs(right.actions["trajectory"] - left.actions["trajectory"])[driving])
        intentions.append(step.actions["intention"][driving])
        states = step.states
        result = batch.step(policy.description.environment_action(step.actions), driving)
        driving &= ~(result.terminated | result.truncated)
    batch.close()
    mean = np.concatenate(turned).mean(axis=0)
    names = [action.name for action in policy.description.levels[-1].actions]
    spread = float(np.concatenate(intentions).std())
    return {
        "intention_deviation": round(spread, 4),
        **{f"change_of_{name}": round(float(value), 4) for name, value in zip(names, mean, strict=True)},
    }


def measured(variant: str, seed: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Train and intervene, unless the file is there."""
    file = arguments.out / f"{variant}-{seed}.json"
    if not file.exists():
        policy = trained(variant, seed, arguments.decisions, arguments.out)
        facts = {"variant": variant, "seed": seed, "decisions": arguments.decisions}
        facts |= intervened(policy, arguments.episodes)
        file.write_text(json.dumps(facts, indent=1) + "\n")
    facts = json.loads(file.read_text())
    print(f"{variant}, seed {seed}: {facts['free']}", flush=True)
    return dict(facts)


def main() -> None:
    """Measure all variants and seeds, as many at once as there are cores."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=list(VARIANTS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--decisions", type=int, default=300_000)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path("runs/hierarchy"))
    arguments = parser.parse_args()
    arguments.out = arguments.out.resolve()
    arguments.out.mkdir(parents=True, exist_ok=True)
    trials = [(variant, seed) for seed in arguments.seeds for variant in arguments.variants]
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        found = list(pool.map(lambda trial: measured(*trial, arguments), trials))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
