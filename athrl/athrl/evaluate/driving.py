"""What is driven in each place, and where its recordings go."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from athrl_protocol.run_file import RunFile
from athrl_spaces.wording import system_reason

from athrl.errors import CommandError, needs
from athrl.evaluate.places import Place

if TYPE_CHECKING:
    from athrl_evaluator import EvaluationSettings


class Drive(NamedTuple):
    """What is driven in a place, and the folder for its recordings."""

    facts: dict[str, str]
    settings: EvaluationSettings
    folder: Path | None


def drive_in(
    settings: RunFile, place: Place, record: Path | None, forced: Sequence[str], many: bool
) -> Drive:
    """Return what is driven in a place; of several places each has its own folder of recordings."""
    with needs("evaluator"):
        from athrl_evaluator import EvaluationSettings
    evaluation = EvaluationSettings(
        episodes=settings.evaluator.final_episodes,
        seed=settings.evaluator.seed,
        environment=place.section,
        case_study=place.case_study,
        forced=forced,
        stall_seconds=settings.actor.stall_seconds,
    )
    return Drive(place.facts, evaluation, record / place.folder if record is not None and many else record)


def scored(
    driver: str | Path, facts: dict[str, str], settings: EvaluationSettings, folder: Path | None
) -> dict[str, Any]:
    """Drive in one place; return its facts, the seed and the scores."""
    with needs("evaluator"):
        from athrl_evaluator import evaluate_driver
    scores = evaluate_driver(driver, settings, record=folder)
    return {**facts, "seed": settings.seed, **scores.as_dict()}


def make_folder(folder: Path | None) -> None:
    """Make the folder for recordings before anything is driven."""
    try:
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            if not os.access(folder, os.W_OK | os.X_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        cause = system_reason(error)
        raise CommandError(
            f"--record {folder}: {cause}, it should be a folder that can be made and written"
        ) from None


def check_recordings(driver: str | Path, drives: Sequence[Drive], overwrite: bool) -> None:
    """Refuse to replace recordings, which may be of another map, before anything is driven."""
    with needs("evaluator"):
        from athrl_evaluator.evaluate import recordings_of
    for _, settings, folder in drives if not overwrite else []:
        for path in recordings_of(driver, settings, folder) if folder is not None else []:
            if path.exists():
                raise CommandError(f"{path} exists already: name another folder, or add --overwrite")
