"""Threads that drive slices of batches of episodes in parallel."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from athrl_driving.episode.drive import drive

BatchSlice = tuple[Any, Any, int, int]
"""Pinned state and pinned orders of episodes, the first episode to drive, and the one after the last."""


class Workers:
    """A number of threads, including the caller's.

    Episodes of several towns that are driven together share their workers: no thread waits while a slice of
    any town is left. A process that was forked from the one that made them gets threads of its own, and so
    does a copy.
    """

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._make_threads()

    def __reduce__(self) -> tuple:
        """Copy their number: threads stay in their process."""
        return Workers, (self.threads,)

    def _make_threads(self) -> None:
        self._driving = False
        self._process = os.getpid()
        self._pool = ThreadPoolExecutor(self.threads - 1, "athrl-drive") if self.threads > 1 else None

    @property
    def _are_of_this_process(self) -> bool:
        return self._process == os.getpid()

    @property
    def are_driving(self) -> bool:
        """Whether a thread of this process is in `drive` now, so that what it drives is changing."""
        return self._driving and self._are_of_this_process

    def drive(self, slices: Sequence[BatchSlice]) -> None:
        """Carry out the orders of all slices; returns when they are done."""
        if not self._are_of_this_process:
            self._make_threads()
        self._driving = True
        try:
            self._share_out(slices)
        finally:
            self._driving = False

    def _share_out(self, slices: Sequence[BatchSlice]) -> None:
        if self._pool is None:
            for each in slices:
                drive(*each)
            return
        others = [self._pool.submit(drive, *each) for each in slices[1:]]
        drive(*slices[0])
        # The other threads take slices from the front; the caller takes those not begun from the back.
        for each, other in zip(reversed(slices[1:]), reversed(others), strict=True):
            if other.cancel():
                drive(*each)
        for other in others:
            if not other.cancelled():
                other.result()

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None and self._are_of_this_process:
            self._pool.shutdown()
