"""Where an evaluator writes in the run's folder, and the results as JSON."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from athrl_protocol import EvaluationResult


class ResultsFolder:
    """The evaluator's part of a run's folder."""

    def __init__(self, runs: Path, run: str) -> None:
        self.path = runs / run
        self.tensorboard = self.path / "tensorboard"
        self.recordings = self.path / "recordings"
        self._lines = self.path / "evaluations.jsonl"
        self._closing = self.path / "evaluation.json"
        self.recordings.mkdir(parents=True, exist_ok=True)
        for part in self.recordings.glob("*.part"):  # of an evaluator that was killed
            part.unlink(missing_ok=True)

    def add(self, result: EvaluationResult) -> None:
        """Append one result to `evaluations.jsonl`."""
        with self._lines.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(asdict(result)) + "\n")

    def write_comparison(self, run: str, results: Sequence[EvaluationResult]) -> None:
        """Write the closing comparison, `evaluation.json`; the file is whole or absent."""
        policy = next(result for result in results if result.driver == "policy")
        document = {
            "run": run,
            "town": policy.town,
            "seed": policy.seed,
            "policy_version": policy.policy_version,
            "environment_steps": policy.environment_steps,
            "drivers": {result.driver: result.scores for result in results},
        }
        part = self._closing.with_name(self._closing.name + ".part")
        part.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
        os.replace(part, self._closing)
