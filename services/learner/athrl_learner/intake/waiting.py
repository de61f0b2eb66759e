"""How long one side has waited: as a share of the time, and without a break until now."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from athrl_learner.intake.limiter import SamplesPerInsert

#: Seconds over which the share is measured that is shown to users.
MINUTE = 60.0
_LEAST_SHARE_SHOWN = 0.05


class WaitingTime:
    """Adds up the time between `begin` and `end`. Not thread-safe."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._since: float | None = None
        self._ended = 0.0  # seconds of all waits that have ended
        self._marks = deque([(clock(), 0.0)])  # at each report: when, and seconds waited until then

    def begin(self) -> None:
        """Waiting begins, or continues if it already had begun."""
        if self._since is None:
            self._since = self._clock()

    def end(self) -> None:
        """Waiting ends, if it had begun."""
        if self._since is not None:
            self._ended += self._clock() - self._since
            self._since = None

    @property
    def lasting(self) -> float:
        """Seconds of waiting without a break until now; 0 if not waiting."""
        return self._clock() - self._since if self._since is not None else 0.0

    def share(self) -> float:
        """Share of the time since the last call that was spent waiting, 0..1; called once for each report."""
        now, waited = self._clock(), self._ended + self.lasting
        reported_at, waited_then = self._marks[-1]
        self._marks.append((now, waited))
        while len(self._marks) > 1 and self._marks[1][0] <= now - MINUTE:
            self._marks.popleft()
        return _share(now - reported_at, waited - waited_then)

    def share_of_the_minute(self) -> float:
        """Share of the last minute, or of the time since the beginning, that was spent waiting, 0..1."""
        began, waited_then = self._marks[0]
        return _share(self._clock() - began, self._ended + self.lasting - waited_then)


def waiting_text(limiter: SamplesPerInsert, learner_share: float, actors_share: float) -> str:
    """Which side waited in the last minute, for which share of it; empty if none did for long."""
    if limiter.closed or not limiter.warmed_up:
        return limiter.explain()
    share = max(learner_share, actors_share)
    if share < _LEAST_SHARE_SHOWN:
        return ""
    learner_waits = learner_share >= actors_share
    who = "the learner waits for data" if learner_waits else "the actors wait for the learner"
    return f"{who}, {100 * share:.0f} % of the last minute ({limiter.ratio_text()})"


def _share(elapsed: float, waited: float) -> float:
    return min(1.0, waited / elapsed) if elapsed > 0 else 0.0
