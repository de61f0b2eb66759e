"""The policy lag: how far the deciding policy is behind the newest known one, and what the actor does.

The newest version is known from the run's state, which arrives each second whether or not the policy itself
arrived. A policy that does not arrive is requested: it was published before the state named it, so the
learner has it. An actor that is too far behind waits and keeps requesting; it does not wait for anything that
depends on the experience that it does not collect meanwhile.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

ASK_SECONDS = 1.0  # after this lag the policy is requested, and again at this interval

log = logging.getLogger(__name__)


class PolicyLag:
    """Compares the deciding version with the newest known one.

    Args:
        bound: versions; with a larger lag the actor waits.
        ask: requests the learner's newest policy and returns immediately.
        clock: seconds, monotonic.
    """

    def __init__(
        self, bound: int, ask: Callable[[], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.versions = 0
        self._bound = bound
        self._ask = ask
        self._clock = clock
        self._behind_since: float | None = None
        self._asked_at = -float("inf")
        self._waiting = False

    @property
    def seconds(self) -> float:
        """Seconds for which a newer version than the deciding one has been known."""
        return 0.0 if self._behind_since is None else self._clock() - self._behind_since

    def update(self, deciding: int, newest: int) -> bool:
        """Update both versions; return whether the actor may keep driving.

        `newest` is lower after a learner has resumed from an older checkpoint: that is no lag.
        """
        self.versions = max(0, newest - deciding)
        if self.versions == 0:
            self._behind_since = None
        elif self._behind_since is None:
            self._behind_since = self._clock()
        if self.seconds > ASK_SECONDS and self._clock() - self._asked_at > ASK_SECONDS:
            self._asked_at = self._clock()
            self._ask()
        self._log_change(deciding, newest)
        return not self._waiting

    def _log_change(self, deciding: int, newest: int) -> None:
        too_far = self.versions > self._bound
        if too_far and not self._waiting:
            log.warning(
                "waiting for a newer policy: version %d decides, the newest is %d, and "
                "actor.policy_lag_versions is %d",
                deciding,
                newest,
                self._bound,
            )
        if self._waiting and not too_far:
            log.warning("continuing with policy %d", deciding)
        self._waiting = too_far
