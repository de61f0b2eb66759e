"""What a run's folder tells of its learning: training averages, and scores on the way."""

from __future__ import annotations

import json
import re
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path

from athrl_spaces.untrusted import PARSER_ERRORS, parser_errors, read_untrusted

from athrl.errors import CommandError, needs

POINTS = 50
"""Of a curve that is kept."""

_ACTORS = re.compile(r"actor/[^/]+/(return_mean|speed)")
_NAMES = {"return_mean": "return_mean", "speed": "speed_mps"}
_MOST_BYTES = 256 * 2**20

Curve = list[tuple[int, float]]
"""Values over decisions."""


def training_curves(folder: Path) -> dict[str, Curve]:
    """Return what the actors reported while they explored: return of an episode, and speed in m/s.

    A report of the return is the mean of an actor's last 20 episodes, so neighbouring points overlap.
    """
    found: dict[str, Curve] = {name: [] for name in _NAMES.values()}
    for file in sorted((folder / "tensorboard").glob("events.out.tfevents.*")):
        for step, name, value in _scalars(file):
            found[_NAMES[name]].append((step, value))
    return {name: sorted(curve) for name, curve in found.items()}


def averages(curves: dict[str, Curve], after: int) -> dict[str, float]:
    """Return the mean of each curve after so many decisions; a curve without any is left out."""
    late = {name: [value for step, value in curve if step > after] for name, curve in curves.items()}
    return {name: round(statistics.fmean(values), 4) for name, values in late.items() if values}


def scores_on_the_way(folder: Path, score: str = "return_mean") -> Curve:
    """Return a score of the run's evaluations while it trained, greedy, over decisions.

    A line that is being written, or is damaged, is left out.

    Raises:
        CommandError: the file cannot be read or is too large.
    """
    path = folder / "evaluations.jsonl"
    if not path.exists():
        return []
    with parser_errors(lambda reason: CommandError(f"{path}: {reason}")):
        lines = read_untrusted(path, _MOST_BYTES).decode(errors="replace").splitlines()
    curve: Curve = []
    for line in lines:
        try:
            result = json.loads(line)
            if result["driver"] == "policy":
                curve.append((int(result["environment_steps"]), float(result["scores"][score])))
        except PARSER_ERRORS:
            continue
    return sorted(curve)


def thinned(curve: Sequence[tuple[int, float]], end: int) -> Curve:
    """Return at most `POINTS` points, each the mean of what lies in its part of `end` decisions."""
    parts: dict[int, Curve] = {}
    for step, value in curve:
        parts.setdefault(min(POINTS - 1, step * POINTS // max(1, end)), []).append((step, value))
    return [
        (
            round(statistics.fmean(step for step, _ in points)),
            round(statistics.fmean(value for _, value in points), 4),
        )
        for _, points in sorted(parts.items())
    ]


def _scalars(file: Path) -> Iterator[tuple[int, str, float]]:
    """Yield decisions, metric and value of the actors' reports in an event file, as far as it is whole."""
    with needs("evaluator"):
        from tensorboard.backend.event_processing.event_file_loader import (  # type: ignore[import-untyped]
            RawEventFileLoader,
        )
        from tensorboard.compat.proto.event_pb2 import Event  # type: ignore[import-untyped]
    for record in RawEventFileLoader(str(file)).Load():
        event = Event.FromString(record)
        for value in event.summary.value:
            match = _ACTORS.fullmatch(value.tag)
            if match is not None:
                yield event.step, match[1], value.simple_value
