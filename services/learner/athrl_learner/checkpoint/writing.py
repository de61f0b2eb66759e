"""Writes checkpoints so that a kill at any moment leaves the ones before intact.

Everything goes into `<name>.part`; each file is brought to the disk, the manifest last, then the folder is
renamed. A reader never looks into a `.part`, so it sees a whole checkpoint or none.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
import torch
import zstandard

from athrl_learner.checkpoint.content import (
    AGENT,
    ARRAY_SUFFIX,
    FORMAT,
    MANIFEST,
    REPLAY,
    STATE,
    UNFINISHED_SUFFIX,
    CheckpointContent,
    checkpoint_name,
    numbered_checkpoints,
)
from athrl_learner.errors import CheckpointFailed


class _HashingFile:
    """A file being written, with the sha256 and the size of what went into it."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._digest = hashlib.sha256()
        self._size = 0

    def write(self, data: bytes) -> int:
        self._digest.update(data)
        self._size += len(data)
        return self._file.write(data)

    def flush(self) -> None:
        self._file.flush()

    def facts(self) -> dict[str, Any]:
        return {"sha256": self._digest.hexdigest(), "bytes": self._size}


def write_checkpoint(folder: Path, content: CheckpointContent, kept: int) -> Path:
    """Write the next checkpoint into `folder` and remove all but the newest `kept`.

    Raises:
        CheckpointFailed: the disk refuses; the checkpoints before are untouched.
    """
    numbers = [number for number, _ in numbered_checkpoints(folder)]
    final = folder / checkpoint_name(max(numbers, default=0) + 1)
    part = final.with_name(final.name + UNFINISHED_SUFFIX)
    try:
        _write_into(part, content)
        part.rename(final)
        _sync_folder(folder)
    except OSError as error:
        shutil.rmtree(part, ignore_errors=True)
        raise CheckpointFailed(f"cannot write the checkpoint {final}: {error.strerror or error}") from None
    for _, path in numbered_checkpoints(folder)[:-kept]:
        shutil.rmtree(path, ignore_errors=True)
    return final


def remove_unfinished(folder: Path) -> list[Path]:
    """Remove what a killed learner left half written; the removed paths."""
    unfinished = sorted(folder.glob(f"*{UNFINISHED_SUFFIX}")) if folder.is_dir() else []
    for path in unfinished:
        shutil.rmtree(path, ignore_errors=True)
    return unfinished


def _write_into(part: Path, content: CheckpointContent) -> None:
    shutil.rmtree(part, ignore_errors=True)
    (part / REPLAY).mkdir(parents=True)
    files: dict[str, dict[str, Any]] = {}

    def add(name: str, write: Callable[[_HashingFile], object]) -> None:
        files[name] = _write_synced(part / name, write)

    add(STATE, lambda file: file.write(json.dumps(content.state, indent=1).encode()))
    add(AGENT, lambda file: torch.save(content.agent, cast(IO[bytes], file)))
    for name, array in content.replay.items():
        add(f"{REPLAY}/{name}{ARRAY_SUFFIX}", partial(_write_array, array))
    _sync_folder(part / REPLAY)
    manifest = {"format": FORMAT, "files": files}
    _write_synced(part / MANIFEST, lambda file: file.write(json.dumps(manifest, indent=1).encode()))
    _sync_folder(part)


def _write_synced(path: Path, write: Callable[[_HashingFile], object]) -> dict[str, Any]:
    with path.open("wb") as file:
        hashing = _HashingFile(file)
        write(hashing)
        file.flush()
        os.fsync(file.fileno())
    return hashing.facts()


def _write_array(array: np.ndarray, file: _HashingFile) -> None:
    # Level 1: bird's eye views shrink many times over and it keeps up with a disk.
    compressor = zstandard.ZstdCompressor(level=1, write_checksum=False)
    with compressor.stream_writer(cast(IO[bytes], file), closefd=False) as stream:
        np.lib.format.write_array(stream, array, allow_pickle=False)


def _sync_folder(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
