"""Small JSON files that services read back from a run's folder."""

from __future__ import annotations

import json
import random
from pathlib import Path

from athrl.errors import CommandError
from athrl.train.comparison import comparison_tables, read_comparison
from athrl_learner import run_changes
from athrl_learner.checkpoint import BestCheckpoint
from athrl_learner.errors import LearnerError
from athrl_learner.publication import recorded_version
from athrl_protocol.announcements.comparison import COMPARISON_FILE, compared_decisions
from athrl_spaces import REFERENCE_DRIVERS

from benchmarks.fuzz import mutations
from benchmarks.fuzz.frame import Parser, file_parser

WAYS = [*mutations.TEXT, *4 * [mutations.changed_json]]


def policy_facts(folder: Path) -> Parser:
    """Return the parser of `policies/latest.json`, which is never refused: what it says is then not known."""
    seed = json.dumps({"version": 3, "environment_steps": 400, "sha256": "0" * 64}).encode()

    def read(path: Path) -> None:
        assert -1 <= recorded_version(path) < 2**63

    return file_parser([seed], WAYS, folder / "latest.json", read)


def scores(folder: Path) -> Parser:
    """Return the parser of the checkpoints' scores, which is never refused either."""
    score = {"score": 12.5, "policy_version": 3, "distance": 1}
    seed = json.dumps({"checkpoint-000001": score, "checkpoint-000002": score}).encode()

    def read(path: Path) -> None:
        best = BestCheckpoint(folder)
        best.add_score(4, 13.0)
        best.choose({"checkpoint-000001": 2, "checkpoint-000002": 5})

    return file_parser([seed], WAYS, folder / "scores.json", read)


def changes(folder: Path) -> Parser:
    """Return the parser of `changes.jsonl`, the changes of a run's settings."""
    change = {"setting": "learner.batch", "was": 64, "now": 128, "environment_steps": 400}
    seed = json.dumps(change).encode()

    def changed_line(chance: random.Random, content: bytes) -> bytes:
        return seed + b"\n" + mutations.changed_json(chance, seed) + b"\n"

    def read(path: Path) -> None:
        for change in run_changes._read(path):
            assert str(change).isprintable()

    ways = [*mutations.TEXT, *4 * [changed_line]]
    return file_parser([seed + b"\n" + seed], ways, folder / "changes.jsonl", read, LearnerError)


def comparison(folder: Path) -> Parser:
    """Return the parser of the closing comparison."""
    names = ("episodes", "return_mean", "return_ci95", "speed_mps", "distance_m", "collision_rate")
    values = dict.fromkeys((*names, "off_lane_rate", "full_episode_rate", "driving_score"), 1.0)
    drivers = dict.fromkeys(("policy", *REFERENCE_DRIVERS), values)
    document = {
        "town": "town03",
        "policy_version": 3,
        "environment_steps": 400,
        "drivers": drivers,
        "towns": {"town03": drivers},
    }

    def read(path: Path) -> None:
        compared_decisions(folder)
        comparison_tables(read_comparison(folder, since=0.0))

    return file_parser([json.dumps(document).encode()], WAYS, folder / COMPARISON_FILE, read, CommandError)
