"""Memory: whether this machine gives what a replay will take, and how the rest is handled."""

from __future__ import annotations

import ctypes
import os

import numpy as np

from athrl_learner.errors import TooLittleMemory

_MMAP_THRESHOLD, _TRIM_THRESHOLD, _TOP_PAD = -3, -1, -2
"""Names of the C library's settings in its `mallopt`."""


def keep_freed_memory() -> None:
    """Have the C library keep what an update frees for the next one, instead of giving it back to the system.

    An update takes and frees a hundred megabytes. Each page that comes back from the system is cleared first,
    which took an eighth of an update's time, and threads waited for each other. Where the C library has no
    `mallopt` nothing happens.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for name, value in ((_MMAP_THRESHOLD, 32 << 20), (_TRIM_THRESHOLD, 1 << 30), (_TOP_PAD, 64 << 20)):
            mallopt(ctypes.c_int(name), ctypes.c_int(value))


def require_memory(wanted: int, capacity: int) -> None:
    """Refuse a replay of `capacity` transitions, `wanted` bytes, that could never be allocated.

    The replay takes its memory with its first sequence, when the run has begun and every restart would end
    the same way. Memory that is asked for and not touched costs nothing.

    Raises:
        TooLittleMemory: the system does not give so much.
    """
    try:
        np.empty(wanted, np.uint8)
    except (MemoryError, ValueError):  # the latter where it is more than any array may have
        has = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        raise TooLittleMemory(
            f"replay.capacity is {capacity}, for which the replay would take {wanted / 2**30:.1f} GiB of "
            f"memory, more than can be had of this machine's {has / 2**30:.1f}: set it to less"
        ) from None
