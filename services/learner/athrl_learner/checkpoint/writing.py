"""Writes checkpoints so that a kill at any moment leaves the earlier ones intact.

Everything goes into `<name>.part`. Each file is synced to the disk, the manifest last, then the folder is
renamed. A reader ignores `.part` folders, so it sees a complete checkpoint or none.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
from pathlib import Path
from typing import Any

import torch
from athrl_spaces.wording import system_reason

from athrl_learner.checkpoint.content import (
    ACTOR,
    AGENT,
    FORMAT,
    MANIFEST,
    STATE,
    UNFINISHED_SUFFIX,
    CheckpointContent,
    checkpoint_name,
    manifest_checksum,
    numbered_checkpoints,
)
from athrl_learner.errors import CheckpointFailed
from athrl_learner.files import Files


def write_checkpoint(folder: Path, content: CheckpointContent, files: Files | None = None) -> Path:
    """Write the next checkpoint into `folder`; the segments that it names must be on the disk already.

    Raises:
        CheckpointFailed: the disk reports an error; earlier checkpoints are untouched.
    """
    files = files or Files()
    final = folder / _next_name(folder)
    part = final.with_name(final.name + UNFINISHED_SUFFIX)
    try:
        _write_into(files, part, content)
        files.rename(part, final)
        files.sync_folder(folder)
    except OSError as error:
        with contextlib.suppress(OSError):
            files.remove_folder(part)
        raise CheckpointFailed(f"cannot write the checkpoint {final}: {system_reason(error)}") from None
    return final


def _next_name(folder: Path) -> str:
    try:
        numbers = [number for number, _ in numbered_checkpoints(folder)]
    except OSError as error:
        reason = system_reason(error)
        raise CheckpointFailed(f"cannot read the folder of checkpoints {folder}: {reason}") from None
    return checkpoint_name(max(numbers, default=0) + 1)


def _write_into(files: Files, part: Path, content: CheckpointContent) -> None:
    files.remove_folder(part)
    files.make_folder(part)
    facts = {
        STATE: _write_synced(files, part / STATE, json.dumps(content.state, indent=1).encode()),
        AGENT: _write_synced(files, part / AGENT, _saved(content.agent)),
    }
    if content.actor is not None:
        facts[ACTOR] = _write_synced(files, part / ACTOR, _saved(content.actor))
    manifest: dict[str, Any] = {
        "format": FORMAT,
        "policy_version": content.policy_version,
        "files": facts,
        "log": content.log.to_json(),
    }
    manifest["sha256"] = manifest_checksum(manifest)
    _write_synced(files, part / MANIFEST, json.dumps(manifest, indent=1).encode())
    files.sync_folder(part)


def _saved(tensors: dict[str, Any]) -> memoryview:
    content = io.BytesIO()
    torch.save(tensors, content)
    return content.getbuffer()


def _write_synced(files: Files, path: Path, content: bytes | memoryview) -> dict[str, Any]:
    with contextlib.closing(files.create(path)) as file:
        file.write(content)
        file.sync()
    return {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
