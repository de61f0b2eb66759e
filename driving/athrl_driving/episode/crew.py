"""Threads that drive pieces of batches of episodes side by side."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from athrl_driving.episode.drive import drive

Piece = tuple[Any, Any, int, int]
"""Pinned state and pinned orders of episodes, the first of them to drive, and the one after the last."""


class Crew:
    """So many threads, the caller's among them.

    Episodes of several towns that are driven together have a crew in common: none of its threads waits while
    there is a piece of any town left.
    """

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._pool = ThreadPoolExecutor(threads - 1, "athrl-drive") if threads > 1 else None

    def drive(self, pieces: Sequence[Piece]) -> None:
        """Do the work that the orders of all pieces have; returns when it is done."""
        if self._pool is None:
            for piece in pieces:
                drive(*piece)
            return
        others = [self._pool.submit(drive, *piece) for piece in pieces[1:]]
        drive(*pieces[0])
        # The other threads take pieces from the front: what they have not begun is taken from the back.
        for piece, other in zip(reversed(pieces[1:]), reversed(others), strict=True):
            if other.cancel():
                drive(*piece)
        for other in others:
            if not other.cancelled():
                other.result()

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()
