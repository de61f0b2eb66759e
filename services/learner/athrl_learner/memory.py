"""Whether this machine gives the memory that a replay will take, asked before anything is written."""

from __future__ import annotations

import os

import numpy as np

from athrl_learner.errors import TooLittleMemory


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
