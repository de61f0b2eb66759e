"""Whether this machine has the cores, the memory, the disk and the compiled simulation that a run needs."""

from __future__ import annotations

import contextlib
import math
import os
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from athrl_protocol.run_file import RunFile

from athrl.doctor.finding import Finding, failed, ok, warning
from athrl.runs import run_folder

CHANNELS = 4
LEARNER_BYTES, ACTOR_BYTES = 2**30, 400 * 2**20
"""What a learner takes beside its replay, and an actor with eight environments."""
LOG_BYTES_PER_TRANSITION, CHECKPOINT_BYTES = 512, 12 * 2**20
SLOW_SYNC_SECONDS = 0.05
_SYNCS, _SYNC_BYTES = 15, 2**16
_CGROUP = Path("/sys/fs/cgroup")


def cores() -> Iterator[Finding]:
    """Look at the cores that this process may use."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = _core_limit()
    share = min(count, limit) if limit else count
    seen = f"{share:g} of {os.cpu_count()}"
    if share < 2:
        yield warning("cores", seen, "a learner and an actor want one each: give this machine two")
    else:
        yield ok("cores", seen)


def memory(settings: RunFile) -> Iterator[Finding]:
    """Hold the memory against the replay of the run file and the services around it."""
    available = available_memory()
    replay = replay_bytes(settings)
    needed = replay + LEARNER_BYTES
    seen = (
        f"{available / 2**30:.1f} GiB free, the replay of {settings.replay.capacity} transitions takes "
        f"{replay / 2**30:.2f}, a learner {LEARNER_BYTES / 2**30:.0f} more, "
        f"an actor {ACTOR_BYTES / 2**30:.1f}"
    )
    if available < replay:
        yield failed("memory", seen, "set a smaller replay.capacity, or use a larger machine")
    elif available < needed + ACTOR_BYTES:
        yield warning("memory", seen, "it gets tight: set a smaller replay.capacity, or free memory")
    else:
        yield ok("memory", seen)


def disk(settings: RunFile) -> Iterator[Finding]:
    """Look whether the run's folder can be written, has room, and what bringing data to its disk costs."""
    folder = run_folder(settings).absolute()
    place = next(path for path in (folder, *folder.parents) if path.is_dir())
    try:
        with tempfile.TemporaryDirectory(dir=place, prefix=".athrl-doctor-") as scratch:
            seconds = _sync_seconds(Path(scratch))
    except OSError as error:
        yield failed(
            "run folder",
            f"cannot write {place}: {(error.strerror or str(error)).lower()}",
            "make room, or choose a folder of yours with run.folder",
        )
        return
    yield ok("run folder", f"{place} can be written")
    yield _room(settings, place)
    yield _sync_cost(settings, seconds)


def simulation() -> Iterator[Finding]:
    """Look whether the simulation's machine code is kept, where the simulation is installed."""
    try:
        from athrl_driving.compilation import cache_folder
    except ModuleNotFoundError:
        return
    folder = Path(cache_folder())
    if folder.name.startswith("athrl-compiled-"):
        with contextlib.suppress(OSError):
            folder.rmdir()
        yield warning(
            "simulation",
            "no folder for machine code can be written: every actor compiles for a minute when it starts",
            "set NUMBA_CACHE_DIR to a folder that can be written",
        )
    elif any(folder.rglob("*.nbi")):
        yield ok("simulation", f"compiled, in {folder}")
    else:
        yield ok("simulation", f"the first start compiles it, a minute, into {folder}")


def replay_bytes(settings: RunFile) -> int:
    """Return about how much memory the replay takes; nearly all of it is images."""
    steps, size = settings.replay.sequence_length, settings.environment.image_size
    sequences = math.ceil(settings.replay.capacity / steps)
    return sequences * (steps + 1) * size * size * CHANNELS


def available_memory() -> int:
    """Return bytes that can still be had, within the container's limit where there is one."""
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with contextlib.suppress(OSError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                free = int(line.split()[1]) * 1024
    with contextlib.suppress(OSError, ValueError):  # "max" is no number: no limit
        limit = int((_CGROUP / "memory.max").read_text())
        free = min(free, limit - int((_CGROUP / "memory.current").read_text()))
    return max(0, free)


def _core_limit() -> float | None:
    with contextlib.suppress(OSError, ValueError):
        quota, period = (_CGROUP / "cpu.max").read_text().split()
        return int(quota) / int(period)
    return None


def _room(settings: RunFile, place: Path) -> Finding:
    facts = os.statvfs(place)
    free = facts.f_bavail * facts.f_frsize
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
    """Return the median time in which a little data comes to the disk; raises OSError."""
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


def _sync_cost(settings: RunFile, seconds: float) -> Finding:
    how = settings.durability.fsync
    seen = f"{seconds * 1000:.1f} ms, durability.fsync is {how!r}"
    if seconds > SLOW_SYNC_SECONDS and how == "acknowledgement":
        return warning("fsync", seen, "actors will wait for the disk: set durability.fsync=interval")
    return ok("fsync", seen)
