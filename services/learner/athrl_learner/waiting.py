"""How long somebody has been waiting, as a share of the time between two reports."""

from __future__ import annotations

import time
from collections.abc import Callable

from athrl_learner.limiter import SamplesPerInsert

_WORTH_TELLING = 0.05


class WaitingTime:
    """Adds up the time between `begin` and `end`. Not thread-safe."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._since: float | None = None
        self._waited = 0.0
        self._reported_at = clock()

    def begin(self) -> None:
        """The waiting begins, or goes on if it already had."""
        if self._since is None:
            self._since = self._clock()

    def end(self) -> None:
        """The waiting is over, if there was any."""
        if self._since is not None:
            self._waited += self._clock() - self._since
            self._since = None

    def share(self) -> float:
        """Share of the time since the last call that was spent waiting, 0..1."""
        now = self._clock()
        if self._since is not None:
            self._waited += now - self._since
            self._since = now
        elapsed, waited = now - self._reported_at, self._waited
        self._reported_at, self._waited = now, 0.0
        return min(1.0, waited / elapsed) if elapsed > 0 else 0.0


def waiting_text(limiter: SamplesPerInsert, learner_share: float, actors_share: float) -> str:
    """Who waited for whom between the last two reports, how much and why; empty if nobody did for long."""
    if limiter.closed or not limiter.warmed_up:
        return limiter.explain()
    share = max(learner_share, actors_share)
    if share < _WORTH_TELLING:
        return ""
    learner_waits = learner_share >= actors_share
    who = "the learner waits for the actors" if learner_waits else "the actors wait for the learner"
    return f"{who}, {share:.0%} of the time: {limiter.ratio_text()}"
