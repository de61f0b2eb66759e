"""Reads checkpoints: checks every file first, and goes back to an older one when the newest is damaged."""

from __future__ import annotations

import hashlib
import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

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
from athrl_learner.errors import CannotResume, DamagedCheckpoint
from athrl_learner.segments import LogPosition

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Manifest:
    """What a checkpoint says of itself.

    Attributes:
        policy_version: the newest policy when it was taken.
        files: facts of each file by its name.
        log: which segments the replay is made of.
    """

    policy_version: int
    files: dict[str, dict[str, Any]]
    log: LogPosition


def newest_intact_checkpoint(folder: Path) -> tuple[Path, CheckpointContent] | None:
    """The newest checkpoint in `folder` that is whole, or None where there is not even a damaged one.

    Each damaged one is named in a warning.

    Raises:
        CannotResume: there are checkpoints, and all of them are damaged.
    """
    damages: list[DamagedCheckpoint] = []
    found = [path for _, path in numbered_checkpoints(folder)]
    for path in reversed(found):
        try:
            return path, read_checkpoint(path)
        except DamagedCheckpoint as damage:
            log.warning(
                "%s; %s", damage, "there is none before" if path == found[0] else "using the one before"
            )
            damages.append(damage)
    if damages:
        raise CannotResume(
            f"no checkpoint in {folder} is whole, of {len(damages)}: {damages[0]}; nothing was changed. "
            f"Start a new run under another run.name, or remove {folder} to train anew with the experience "
            f"that is in {folder.parent / 'experience'}"
        )
    return None


def read_checkpoint(path: Path) -> CheckpointContent:
    """Check every file of the checkpoint at `path` against its manifest, then read it (tensors on the CPU).

    Raises:
        DamagedCheckpoint: a file is missing, altered or cannot be read; names it.
        CannotResume: it was written by another version of the format.
    """
    manifest = read_manifest(path)
    for name, facts in manifest.files.items():
        _check_file(path / name, facts)
    try:
        return CheckpointContent(
            state=json.loads((path / STATE).read_bytes()),
            agent=_loaded(path / AGENT),
            log=manifest.log,
            actor=_loaded(path / ACTOR) if ACTOR in manifest.files else None,
        )
    except Exception as error:
        # The checksums agree, so this is no bit flip; whatever is wrong, an older checkpoint may be right.
        raise DamagedCheckpoint(f"checkpoint {path} cannot be read: {error}") from None


def _loaded(path: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    return loaded


def read_manifest(checkpoint: Path) -> Manifest:
    """The manifest of the checkpoint at that path; raises as `read_checkpoint` does."""
    path = checkpoint / MANIFEST
    try:
        values = json.loads(path.read_bytes())
        if values["sha256"] != manifest_checksum(values):
            raise ValueError("altered")
        version = values["format"]  # after the checksum: a flipped bit makes no other release of it
        if version != FORMAT:
            raise CannotResume(f"{checkpoint} has checkpoint format {version}, this learner reads {FORMAT}")
        manifest = Manifest(
            int(values["policy_version"]), dict(values["files"]), LogPosition.from_json(values["log"])
        )
    except (OSError, ValueError, KeyError, TypeError):
        raise DamagedCheckpoint(f"checkpoint file {path} is missing or damaged") from None
    if not {STATE, AGENT} <= set(manifest.files):
        raise DamagedCheckpoint(f"checkpoint file {path} is damaged: it does not list {STATE} and {AGENT}")
    return manifest


def _check_file(path: Path, facts: dict[str, Any]) -> None:
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise DamagedCheckpoint(f"checkpoint file {path} cannot be read: {error.strerror}") from None
    if not isinstance(facts, dict) or digest != facts.get("sha256"):
        raise DamagedCheckpoint(f"checkpoint file {path} is damaged: its checksum is not the manifest's")
