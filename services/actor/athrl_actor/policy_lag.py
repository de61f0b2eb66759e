"""How far the deciding policy is behind the newest one, as far as the actor knows, and what it does about it.

The newest version is known from the run's state, which comes each second whether the policy itself came or
not. A policy that does not come is asked for: it was published before the state told of it, so the learner
has it. An actor that is too far behind waits, and asks on; it does not wait for anything that depends on the
experience that it does not collect meanwhile.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

ASK_SECONDS = 1.0  # behind for so long, the policy is asked for, and again after as long

log = logging.getLogger(__name__)


class PolicyLag:
    """Compares the version that decides with the newest that is known.

    Args:
        bound: versions; with more than that the actor waits.
        ask: asks the learner for its newest policy and returns at once.
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
        """For how long a newer version than the deciding one has been known."""
        return 0.0 if self._behind_since is None else self._clock() - self._behind_since

    def look(self, deciding: int, newest: int) -> bool:
        """Take note of both versions; return whether the actor may drive on.

        `newest` is lower after a learner has gone back to a checkpoint: that is no lag.
        """
        self.versions = max(0, newest - deciding)
        if self.versions == 0:
            self._behind_since = None
        elif self._behind_since is None:
            self._behind_since = self._clock()
        if self.seconds > ASK_SECONDS and self._clock() - self._asked_at > ASK_SECONDS:
            self._asked_at = self._clock()
            self._ask()
        self._say_whether_it_waits(deciding, newest)
        return not self._waiting

    def _say_whether_it_waits(self, deciding: int, newest: int) -> None:
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
            log.warning("going on with policy %d", deciding)
        self._waiting = too_far
