"""The scores of a driver from outside: `athrl evaluate` as a child process."""

from __future__ import annotations

import json
import statistics
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from athrl_spaces.untrusted import parser_errors

from athrl.study.file import SCORES
from athrl.study.runs import RunFailed, run_to_end
from athrl.train.process import ServiceProcess

EVALUATION_SECONDS = 4 * 3600.0
"""Limit of one evaluation."""


def evaluated(words: Sequence[str], log: Path, stop: threading.Event, *, threads: int) -> dict[str, float]:
    """Run `athrl evaluate --json` and return the scores that a study keeps; of several towns their means.

    Raises:
        RunFailed: it ended with an error, not in time, or without scores.
        Stopped: `stop` was set before it ended.
    """
    process = ServiceProcess("evaluate", list(words), log, threads=threads)
    run_to_end(process, stop, EVALUATION_SECONDS, 0.0, lambda: None)
    return scores_said(process.last_lines())


def scores_said(lines: Sequence[str]) -> dict[str, float]:
    """Return the scores in the JSON object that is one of these lines, as `evaluated` does.

    Raises:
        RunFailed: there is none, or it is damaged.
    """
    for line in reversed(lines):
        if line.startswith("{"):
            with parser_errors(lambda reason: RunFailed(f"athrl evaluate printed no scores: {reason}")):
                return _means(json.loads(line))
    raise RunFailed("athrl evaluate printed no scores")


def _means(found: dict[str, Any]) -> dict[str, float]:
    towns = found.get("towns", [found])
    return {
        score: round(statistics.fmean(float(town[score]) for town in towns), 5)
        for score in SCORES
        if all(score in town for town in towns)
    }
