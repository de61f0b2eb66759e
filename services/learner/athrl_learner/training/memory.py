"""Memory: whether this machine has enough for the replay, and how freed memory is handled."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

import numpy as np

from athrl_learner.errors import TooLittleMemory

_MMAP_THRESHOLD, _TRIM_THRESHOLD, _TOP_PAD = -3, -1, -2
"""Parameters of the C library's `mallopt`."""

LIMIT_FILES = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))
"""Where a container sees the limit of its memory, by control groups of version 2 and 1."""

NO_LIMIT = 2**60
"""From here on a number in such a file means that there is no limit."""


def keep_freed_memory() -> None:
    """Let the C library keep freed memory for the next update, instead of returning it to the system.

    An update allocates and frees a hundred megabytes. The system clears each page that it gives out again,
    which took an eighth of an update's time, and threads waited for each other. Does nothing if the C library
    has no `mallopt`.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for name, value in ((_MMAP_THRESHOLD, 32 << 20), (_TRIM_THRESHOLD, 1 << 30), (_TOP_PAD, 64 << 20)):
            mallopt(ctypes.c_int(name), ctypes.c_int(value))


def require_memory(wanted: int, capacity: int) -> None:
    """Refuse a replay of `capacity` transitions, `wanted` bytes, that could never be allocated.

    The replay allocates its memory with its first sequence, when the run has started and every restart would
    fail in the same way. Memory that is allocated and not touched costs nothing.

    Raises:
        TooLittleMemory: the system does not provide so much, or the limit of the container is below.
    """
    limit = container_limit()
    if limit is not None and wanted > limit:
        raise _too_little(wanted, capacity, f"the {limit / 2**30:.1f} that its container may use")
    try:
        np.empty(wanted, np.uint8)
    except (MemoryError, ValueError):  # the latter if it exceeds the size of any array
        has = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        raise _too_little(wanted, capacity, f"this machine has free of its {has / 2**30:.1f}") from None


def container_limit() -> int | None:
    """Bytes that this process's container may use; None without a limit.

    The system gives a container more than its limit, and kills it when it uses that.
    """
    for path in LIMIT_FILES:
        try:
            limit = int(path.read_text())
        except (OSError, ValueError):  # "max" is no limit
            continue
        if limit < NO_LIMIT:
            return limit
    return None


def _too_little(wanted: int, capacity: int, than: str) -> TooLittleMemory:
    return TooLittleMemory(
        f"replay.capacity is {capacity}, for which the replay would take {wanted / 2**30:.1f} GiB of memory, "
        f"more than {than}: set it to less"
    )
