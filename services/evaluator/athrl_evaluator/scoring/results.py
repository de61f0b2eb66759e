"""The evaluator's files in the run's folder, with the results as JSON."""

from __future__ import annotations

import errno
import json
import logging
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from athrl_protocol import EvaluationResult
from athrl_protocol.announcements.comparison import COMPARISON_FILE
from athrl_protocol.faults.bounded_log import RareLog
from athrl_spaces.whole_files import write_whole
from athrl_spaces.wording import system_reason

from athrl_evaluator.errors import writing

log = logging.getLogger(__name__)


class ResultsFolder:
    """The evaluator's part of a run's folder.

    Attributes:
        warn: logs that something cannot be written there; at most one line a minute, whatever it is.
    """

    def __init__(self, runs: Path, run: str) -> None:
        """Make the folder if it does not exist; raises EvaluatorError if that fails."""
        self.path = runs / run
        self.tensorboard = self.path / "tensorboard"
        self.recordings = self.path / "recordings"
        self._lines = self.path / "evaluations.jsonl"
        self._closing = self.path / COMPARISON_FILE
        self._unwritten: list[str] = []
        self.warn = RareLog(log.warning)
        with writing(self.recordings):
            self.recordings.mkdir(parents=True, exist_ok=True)
            for part in self.recordings.glob("*.part"):  # of an evaluator that was killed
                part.unlink(missing_ok=True)

    def add(self, result: EvaluationResult) -> None:
        """Append one result to `evaluations.jsonl`; one that a full disk rejects is written with the next."""
        self._unwritten.append(json.dumps(asdict(result)) + "\n")
        try:
            append("".join(self._unwritten).encode(), self._lines)
        except OSError as error:
            self.warn(f"cannot write {self._lines}: {system_reason(error)}; the result is kept for later")
        else:
            self._unwritten.clear()

    def write_comparison(self, run: str, results: Sequence[EvaluationResult]) -> None:
        """Write the closing comparison, `COMPARISON_FILE`; the file is complete or absent.

        With several towns, `towns` also has the drivers' scores in each town.

        Raises:
            EvaluatorError: it cannot be written.
        """
        policy = next(result for result in results if result.driver == "policy")
        document: dict[str, Any] = {
            "run": run,
            "town": policy.town,
            "seed": policy.seed,
            "policy_version": policy.policy_version,
            "environment_steps": policy.environment_steps,
            "drivers": {result.driver: scores_over_all(result.scores) for result in results},
        }
        towns = dict.fromkeys(town for _, town, _ in _split_names(policy.scores) if town)
        if towns:
            document["towns"] = {
                town: {result.driver: scores_in(town, result.scores) for result in results} for town in towns
            }
        with writing(self._closing):
            write_whole(self._closing, (json.dumps(document, indent=2) + "\n").encode())


def scores_over_all(scores: Mapping[str, float]) -> dict[str, float]:
    """The scores over all towns among a driver's scores."""
    return scores_in("", scores)


def scores_in(town: str, scores: Mapping[str, float]) -> dict[str, float]:
    """The scores in one town among a driver's scores, whose names are `town/score`."""
    return {name: scores[full] for full, of, name in _split_names(scores) if of == town}


def _split_names(scores: Mapping[str, float]) -> Iterator[tuple[str, str, str]]:
    """Yield each full name, its town, which may be empty, and the name of the score."""
    for full_name in scores:
        town, _, name = full_name.rpartition("/")
        yield full_name, town, name


def append(content: bytes, path: Path) -> None:
    """Append all of the content or nothing; raises OSError."""
    with path.open("ab", buffering=0) as stream:
        size = stream.seek(0, os.SEEK_END)
        try:
            if stream.write(content) != len(content):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError:
            stream.truncate(size)
            raise
