"""Threads that compute parts of an update in parallel.

Each thread computes whole layers on its part of the batch, and they synchronise once in an update. Threads
within operations synchronise some hundred times, and all of them wait whenever an actor or the evaluator
needs a core for a moment.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Part = TypeVar("Part")
Result = TypeVar("Result")


class Workers:
    """The calling thread and `threads` - 1 others."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._others = ThreadPoolExecutor(threads - 1, "update") if threads > 1 else None

    def each(self, compute: Callable[[int, Part], Result], parts: Sequence[Part]) -> list[Result]:
        """Call `compute` with the index of each part and the part, in parallel; return results in order.

        An exception of a call is raised when all calls have returned.
        """
        if self._others is None or len(parts) == 1:
            return [compute(number, part) for number, part in enumerate(parts)]
        waiting = [
            self._others.submit(compute, number, part) for number, part in enumerate(parts) if number > 0
        ]
        try:
            first = compute(0, parts[0])
        finally:
            failures = [future.exception() for future in waiting]
        for failure in failures:
            if failure is not None:
                raise failure
        return [first, *(future.result() for future in waiting)]
