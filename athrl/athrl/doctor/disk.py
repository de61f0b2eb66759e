"""Checks that the disk of the run can be written, has space, and is fast enough."""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from athrl_protocol.run_file import RunFile
from athrl_spaces.wording import system_reason

from athrl.doctor.finding import Finding, failed, ok, warning
from athrl.runs import run_folder

LOG_BYTES_PER_TRANSITION, CHECKPOINT_BYTES = 512, 12 * 2**20
SLOW_SYNC_SECONDS = 0.05
SLOW_MEBIBYTES_PER_SECOND = 10.0
"""Rate at which 20,000 transitions a second are written to the log."""
_SYNCS, _SYNC_BYTES = 15, 2**16
_WRITTEN_BYTES, _BLOCK_BYTES = 32 * 2**20, 2**20


def run_place(settings: RunFile) -> Path:
    """Return the run's folder, or its nearest existing parent, which is on the run's disk."""
    folder = run_folder(settings).absolute()
    return next(path for path in (folder, *folder.parents) if path.is_dir())


def scratch_folder(place: Path) -> AbstractContextManager[str]:
    """Make a temporary folder on the disk of `place`; entering raises OSError."""
    return tempfile.TemporaryDirectory(dir=place, prefix=".athrl-doctor-")


def room_left(settings: RunFile, place: Path) -> int:
    """Return the bytes that the log can still use, without the space reserved for checkpoints."""
    return _free_bytes(place) - round(settings.durability.reserve_mebibytes * 2**20)


def disk(settings: RunFile) -> Iterator[Finding]:
    """Check that the run's folder can be written and has space, and how long syncing to its disk takes."""
    place = run_place(settings)
    try:
        with scratch_folder(place) as scratch:
            seconds = _sync_seconds(Path(scratch))
    except OSError as error:
        yield failed(
            "run folder",
            f"cannot write {place}: {system_reason(error)}",
            "make room, or choose another folder with run.folder",
        )
        return
    yield ok("run folder", f"{place} can be written")
    yield _room(settings, place)
    if room_left(settings, place) > 2 * _WRITTEN_BYTES:
        with scratch_folder(place) as scratch:
            yield _speed(_bytes_per_second(Path(scratch)) / 2**20)
    yield _sync_cost(settings, seconds)


def _free_bytes(place: Path) -> int:
    facts = os.statvfs(place)
    return facts.f_bavail * facts.f_frsize


def _room(settings: RunFile, place: Path) -> Finding:
    free = _free_bytes(place)
    reserve = settings.durability.reserve_mebibytes * 2**20
    log = settings.replay.capacity * LOG_BYTES_PER_TRANSITION
    needed = reserve + log + (settings.learner.checkpoints_kept + 2) * CHECKPOINT_BYTES
    seen = f"{free / 2**30:.1f} GiB free, a run takes about {needed / 2**30:.1f}"
    if free < reserve:
        return failed("disk", seen, "intake would pause at once: make room, or choose another run.folder")
    if free < needed:
        return warning("disk", seen, "intake will pause when the disk is full: make room")
    return ok("disk", seen)


def _sync_seconds(folder: Path) -> float:
    """Return the median time to sync a little data to the disk; raises OSError."""
    seconds = []
    descriptor = os.open(folder / "sync", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    try:
        for _ in range(_SYNCS):
            os.write(descriptor, bytes(_SYNC_BYTES))
            began = time.perf_counter()
            os.fsync(descriptor)
            seconds.append(time.perf_counter() - began)
    finally:
        os.close(descriptor)
    return statistics.median(seconds)


def _bytes_per_second(folder: Path) -> float:
    """Return the speed of writing much data; random data, as some disks compress; raises OSError."""
    block = os.urandom(_BLOCK_BYTES)
    descriptor = os.open(folder / "speed", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    try:
        began = time.perf_counter()
        for _ in range(_WRITTEN_BYTES // _BLOCK_BYTES):
            os.write(descriptor, block)
        os.fsync(descriptor)
        return _WRITTEN_BYTES / (time.perf_counter() - began)
    finally:
        os.close(descriptor)


def _speed(mebibytes: float) -> Finding:
    seen = f"{mebibytes:.0f} MiB/s"
    if mebibytes < SLOW_MEBIBYTES_PER_SECOND:
        return warning(
            "disk speed", seen, "many actors will wait for it: choose another disk with run.folder"
        )
    return ok("disk speed", seen)


def _sync_cost(settings: RunFile, seconds: float) -> Finding:
    how = settings.durability.fsync
    seen = f"{seconds * 1000:.1f} ms, durability.fsync is {how!r}"
    if seconds > SLOW_SYNC_SECONDS and how == "acknowledgement":
        return warning("fsync", seen, "actors will wait for the disk: set durability.fsync=interval")
    return ok("fsync", seen)
