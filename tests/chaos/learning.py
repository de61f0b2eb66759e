"""Checks that the policy improved: the first and the last one on the same episodes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from tests.chaos.run import ChaosRun

EPISODES = 24
_SECONDS = 400.0


class Return(NamedTuple):
    """Mean return of a policy's episodes, and half the width of its 95 % interval."""

    mean: float
    ci95: float


def evaluate(run: ChaosRun, policy: Path) -> Return:
    """Drive episodes with a policy's file, without exploration."""
    result = subprocess.run(
        [
            *(sys.executable, "-m", "athrl", "evaluate", "--policy", str(policy), "--json"),
            *("--episodes", str(EPISODES), "--run-file", str(run.run_folder / "run.toml")),
        ],
        capture_output=True,
        text=True,
        timeout=_SECONDS,
        check=True,
    )
    scores = json.loads(result.stdout)
    return Return(round(scores["return_mean"], 1), round(scores["return_ci95"], 1))


def improved(first: Return, last: Return) -> bool:
    """Whether the last policy is significantly better."""
    return last.mean - first.mean > (first.ci95**2 + last.ci95**2) ** 0.5
