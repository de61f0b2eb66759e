"""Reads checkpoints: checks every file first, and uses an older one if the newest is damaged."""

from __future__ import annotations

import hashlib
import json
import logging
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from athrl_spaces.untrusted import open_untrusted, parser_errors, read_untrusted

from athrl_learner.checkpoint.content import (
    ACTOR,
    AGENT,
    FORMAT,
    MANIFEST,
    STATE,
    CheckpointContent,
    manifest_checksum,
    numbered_checkpoints,
)
from athrl_learner.checkpoint.form import read_state, read_tensors, require_agent
from athrl_learner.checkpoint.log_check import require_own_segments
from athrl_learner.errors import CannotResume, DamagedCheckpoint, SegmentsMissing
from athrl_learner.log import LogPosition, count_of

log = logging.getLogger(__name__)

MOST_JSON_BYTES = 16 * 2**20
"""Of a manifest or a state, which have a few MB with thousands of segments and incarnations."""
MOST_TENSOR_BYTES = 4 * 2**30
"""Of the state of planner or actor."""


@dataclass(frozen=True)
class Manifest:
    """Contents of a checkpoint's manifest.

    Attributes:
        policy_version: the newest policy when the checkpoint was taken.
        files: facts of each file by its name.
        log: the segments that hold the replay.
    """

    policy_version: int
    files: dict[str, dict[str, Any]]
    log: LogPosition


def newest_intact_checkpoint(
    folder: Path, experience: Path | None = None
) -> tuple[Path, CheckpointContent] | None:
    """The newest complete checkpoint in `folder`, or None if the folder has no checkpoint.

    A warning names each damaged one.

    Args:
        folder: of the checkpoints.
        experience: folder of the log; a checkpoint without its segments, or of another run's log, counts as
            damaged. None: the log is not looked at.

    Raises:
        CannotResume: all checkpoints are damaged.
    """
    damages: list[DamagedCheckpoint] = []
    found = [path for _, path in numbered_checkpoints(folder)]
    for path in reversed(found):
        try:
            content = read_checkpoint(path)
            if experience is not None:
                require_own_segments(path, content.log, experience)
                _require_replay(path, content, damages)
            return path, content
        except DamagedCheckpoint as damage:
            log.warning(
                "%s; %s", damage, "there is none before" if path == found[0] else "using the one before"
            )
            damages.append(damage)
    if damages:
        raise CannotResume(
            f"all {len(damages)} checkpoints in {folder} are damaged: {damages[0]}; nothing was changed. "
            f"{_remedy(damages, folder)}"
        )
    return None


def _require_replay(path: Path, content: CheckpointContent, newer: list[DamagedCheckpoint]) -> None:
    """Refuse a checkpoint without a replay where newer ones lost theirs: all training would be lost, too."""
    if not content.log.segments and any(isinstance(damage, SegmentsMissing) for damage in newer):
        raise SegmentsMissing(f"checkpoint {path} is from before the first experience")


def _remedy(damages: list[DamagedCheckpoint], folder: Path) -> str:
    experience = folder.parent / "experience"
    if all(isinstance(damage, SegmentsMissing) for damage in damages):
        return (
            f"Put the segments back into {experience} from a copy of the run's folder, or start a new run "
            f"under another run.name; the newest policy is in {folder.parent / 'policies'}"
        )
    return (
        f"Start a new run under another run.name, or remove {folder} to train again with the experience "
        f"in {experience}"
    )


def read_checkpoint(path: Path) -> CheckpointContent:
    """Check every file of the checkpoint at `path` against its manifest, then read it (tensors on the CPU).

    Raises:
        DamagedCheckpoint: a file is missing, altered or cannot be read; names it.
        CannotResume: it has another version of the format.
    """
    manifest = read_manifest(path)
    for name, facts in manifest.files.items():
        _check_file(path / name, facts)
    # From here on the checksums agree, so no bit has flipped; an older checkpoint may still be readable.
    with _damage_of(path / STATE):
        state = read_state(read_untrusted(path / STATE, MOST_JSON_BYTES))
    agent = _tensors(path / AGENT)
    with _damage_of(path / AGENT):
        require_agent(agent)
    actor = _tensors(path / ACTOR) if ACTOR in manifest.files else None
    return CheckpointContent(state=state, agent=agent, log=manifest.log, actor=actor)


def read_manifest(checkpoint: Path) -> Manifest:
    """The manifest of the checkpoint at that path; raises as `read_checkpoint` does."""
    path = checkpoint / MANIFEST
    with _damage_of(path):
        values = json.loads(read_untrusted(path, MOST_JSON_BYTES))
        if values["sha256"] != manifest_checksum(values):
            raise ValueError("its checksum differs")
        # After the checksum, so that a flipped bit does not look like another release.
        version = count_of(values["format"])
        if version != FORMAT:
            raise CannotResume(f"{checkpoint} has checkpoint format {version}, this learner reads {FORMAT}")
        files = dict(values["files"])
        if not {STATE, AGENT} <= files.keys() <= {STATE, AGENT, ACTOR}:
            raise ValueError(f"it does not list {STATE} and {AGENT}, and maybe {ACTOR}")
        if not all(isinstance(facts, dict) and "sha256" in facts for facts in files.values()):
            raise ValueError("it has no checksum of a file")
        return Manifest(count_of(values["policy_version"], -1), files, LogPosition.from_json(values["log"]))


def _tensors(path: Path) -> dict[str, Any]:
    # What torch raises for a damaged archive, or for what it does not unpickle, is of many classes.
    with _damage_of(path, Exception), open_untrusted(path, MOST_TENSOR_BYTES) as file:
        return read_tensors(file)


def _check_file(path: Path, facts: dict[str, Any]) -> None:
    most = MOST_JSON_BYTES if path.name == STATE else MOST_TENSOR_BYTES
    with _damage_of(path):
        with open_untrusted(path, most) as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        if digest != facts["sha256"]:
            raise ValueError("its checksum is not the manifest's")


def _damage_of(path: Path, *libraries: type[Exception]) -> AbstractContextManager[None]:
    """Makes every error of a parser inside the block a `DamagedCheckpoint` that names the file."""
    return parser_errors(
        lambda reason: DamagedCheckpoint(f"checkpoint file {path} is damaged ({reason})"),
        OSError,
        *libraries,
    )
