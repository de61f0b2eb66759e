"""Whether this machine has the cores, the memory and the compiled simulation that a run needs."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from pathlib import Path

from athrl_protocol.run_file import RunFile

from athrl.doctor.finding import Finding, failed, ok, warning

CHANNELS = 4
LEARNER_BYTES, ACTOR_BYTES = 2**30, 400 * 2**20
"""What a learner takes beside its replay, and an actor with eight environments."""
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
