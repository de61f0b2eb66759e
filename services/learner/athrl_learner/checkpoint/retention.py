"""Which checkpoints are kept: the newest few, and the best one."""

from __future__ import annotations

import json
import logging
import math
import os
import threading
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from athrl_spaces.untrusted import UntrustedFile, parser_errors, read_json

from athrl_learner.checkpoint.content import UNFINISHED_SUFFIX, numbered_checkpoints
from athrl_learner.checkpoint.reading import read_manifest
from athrl_learner.errors import LearnerError
from athrl_learner.files import Files, write_whole
from athrl_learner.log import LogPosition, count_of

log = logging.getLogger(__name__)

SCORES = "scores.json"


@dataclass(frozen=True)
class Score:
    """An evaluator's score of the policy nearest to a checkpoint.

    Attributes:
        score: mean return of its episodes.
        policy_version: version of the scored policy.
        distance: versions between the scored policy and the checkpoint.
    """

    score: float
    policy_version: int
    distance: int


@dataclass(frozen=True)
class KeptCheckpoints:
    """Positions in the log of the newest checkpoints, and of others that are kept."""

    newest: list[LogPosition]
    others: list[LogPosition]
    best: str | None  # its name; None without a score


class BestCheckpoint:
    """Stores in the checkpoints' folder which checkpoint is the best by the evaluator's scores.

    An evaluator scores policies, and checkpoints are rarely written exactly at a publication. So a score
    belongs to the checkpoint whose policy version is nearest, and of several scores the nearest counts.
    """

    def __init__(self, folder: Path, files: Files | None = None) -> None:
        self._folder = folder
        self._files = files or Files()
        self._new_scores: list[tuple[int, float]] = []  # policy version, score
        self._lock = threading.Lock()
        self._scores = _read_scores(folder / SCORES)

    def add_score(self, policy_version: int, score: float) -> None:
        """Add a published score; may be called from any thread."""
        if math.isfinite(score):
            with self._lock:
                self._new_scores.append((policy_version, score))

    def choose(self, versions: dict[str, int]) -> str | None:
        """The best of the existing checkpoints, or None if none of them has a score.

        Args:
            versions: of the policy in each checkpoint, by the checkpoint's name.

        Raises:
            OSError: the scores cannot be written.
        """
        before = dict(self._scores)
        self._scores = {name: score for name, score in self._scores.items() if name in versions}
        if versions:
            with self._lock:
                new_scores, self._new_scores = self._new_scores, []
            for policy_version, score in new_scores:
                self._attribute(policy_version, score, versions)
        if self._scores != before:
            content = {name: asdict(score) for name, score in self._scores.items()}
            write_whole(self._files, self._folder / SCORES, json.dumps(content, indent=1).encode())
        return max(self._scores, key=lambda name: self._scores[name].score, default=None)

    def _attribute(self, policy_version: int, score: float, versions: dict[str, int]) -> None:
        name = min(versions, key=lambda name: abs(versions[name] - policy_version))
        distance = abs(versions[name] - policy_version)
        if name not in self._scores or distance <= self._scores[name].distance:
            self._scores[name] = Score(score, policy_version, distance)


def remove_unneeded(
    folder: Path, kept: int, best: BestCheckpoint, files: Files | None = None
) -> KeptCheckpoints:
    """Remove all checkpoints but the newest `kept` and the best one; return what is left.

    Raises:
        OSError: the disk reports an error.
    """
    files = files or Files()
    positions: dict[str, LogPosition] = {}
    versions: dict[str, int] = {}
    for _, path in numbered_checkpoints(folder):
        try:
            manifest = read_manifest(path)
        except LearnerError as error:
            log.warning("%s; it is kept while it is one of the newest", error)
            continue
        positions[path.name], versions[path.name] = manifest.log, manifest.policy_version
    chosen = best.choose(versions)
    names = [path.name for _, path in numbered_checkpoints(folder)]
    newest, older = names[-kept:], names[:-kept]
    for name in older:
        if name != chosen:
            _remove(files, folder / name)
    return KeptCheckpoints(
        [positions[name] for name in newest if name in positions],
        [positions[name] for name in older if name == chosen],
        chosen,
    )


def remove_unfinished(folder: Path) -> list[Path]:
    """Remove what a killed learner left half written or half removed; return the removed paths."""
    unfinished = sorted(folder.glob(f"*{UNFINISHED_SUFFIX}")) if folder.is_dir() else []
    for path in unfinished:
        if path.is_dir():
            Files().remove_folder(path)
        else:
            path.unlink(missing_ok=True)
    return unfinished


def _remove(files: Files, path: Path) -> None:
    # Renamed first: a partial checkpoint must never have the name of a complete one.
    going = path.with_name(path.name + UNFINISHED_SUFFIX)
    files.rename(path, going)
    files.remove_folder(going)


def _read_scores(path: Path) -> dict[str, Score]:
    if not os.path.lexists(path):
        return {}
    try:
        with parser_errors(UntrustedFile):
            return {name: _score(**score) for name, score in read_json(path).items()}
    except UntrustedFile as error:
        log.warning("%s: %s; the best checkpoint is not known any more", path, error)
        return {}


def _score(score: Any, policy_version: Any, distance: Any) -> Score:
    if isinstance(score, bool) or not isinstance(score, int | float) or not math.isfinite(score):
        raise ValueError(f"a score is {score!r:.60}, should be a finite number")
    return Score(float(score), count_of(policy_version), count_of(distance))
