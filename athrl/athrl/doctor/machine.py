"""Checks of the cores, the memory and the compiled simulation that a run needs."""

from __future__ import annotations

import contextlib
import importlib.util
import math
import os
from collections.abc import Iterator
from pathlib import Path

from athrl_protocol.run_file import RunFile
from athrl_spaces import CHANNELS

from athrl.doctor.finding import Finding, failed, ok, warning
from athrl.errors import CommandError
from athrl.train.plan import require_world

LEARNER_BYTES, ACTOR_BYTES = 2**30, 400 * 2**20
"""Memory of a learner without its replay, and of an actor with 64 environments."""
_CGROUP = Path("/sys/fs/cgroup")


def cores() -> Iterator[Finding]:
    """Check the cores that this process may use."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = _core_limit()
    share = min(count, limit) if limit else count
    seen = f"{share:g} of {os.cpu_count()}"
    if share < 2:
        yield warning("cores", seen, "a learner and an actor need one each: use a machine with two")
    else:
        yield ok("cores", seen)


def memory(settings: RunFile) -> Iterator[Finding]:
    """Compare the free memory with the replay of the run file and the services."""
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
        yield warning("memory", seen, "that is tight: set a smaller replay.capacity, or free memory")
    else:
        yield ok("memory", seen)


def simulation() -> Iterator[Finding]:
    """Check that the simulation's machine code is cached, if the simulation is installed."""
    try:
        from athrl_driving.kernels.compilation import cache_folder
        from athrl_driving.kernels.machine_code import INDEX, is_temporary
    except ModuleNotFoundError:
        return
    folder = Path(cache_folder())
    if any(folder.rglob(f"*{INDEX}")):
        place = "a folder that can only be read" if is_temporary(folder) else folder
        yield ok("simulation", f"compiled, in {place}")
    elif is_temporary(folder):
        yield warning(
            "simulation",
            "no folder for machine code can be written: every actor compiles for a minute at its start",
            "set NUMBA_CACHE_DIR to a writable folder",
        )
    else:
        yield ok("simulation", f"the first start compiles it, a minute, into {folder}")


def towns(settings: RunFile) -> Iterator[Finding]:
    """Check that each town of the run can be driven in and has room for its vehicles."""
    if importlib.util.find_spec("athrl_driving") is None:
        return
    for town, share in settings.environment.towns.items():
        alone = settings.environment.model_copy(update={"towns": {town: share}})
        try:
            require_world(alone)
        except (CommandError, ValueError) as error:
            yield failed("towns", str(error), "change environment.towns or environment.vehicles")
        else:
            yield ok("towns", f"{town} has room for {settings.environment.vehicles} vehicles")


def replay_bytes(settings: RunFile) -> int:
    """Return the approximate memory of the replay; nearly all of it is images."""
    steps, size = settings.replay.sequence_length, settings.environment.image_size
    sequences = math.ceil(settings.replay.capacity / steps)
    return sequences * (steps + 1) * size * size * len(CHANNELS)


def available_memory() -> int:
    """Return the available bytes, within the container's limit if there is one."""
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
