"""How many chunks each actor may have under way, from how many were heard of late. No network, no threads."""

from __future__ import annotations

import math
import time

# Queries that may wait at the learner. A full queue would stop everything else on the link, so the credits of
# all actors together stay below it.
QUEUE_CAPACITY = 256
# Of one actor: enough that neither side waits for the other's turn on a busy machine or a slow network.
CREDITS = 32
ACTIVE_SECONDS = 10.0
# How often silent actors are looked for; not every chunk pays for looking at a thousand of them.
FORGET_SECONDS = 0.5


class Credits:
    """Shares the learner's queue among the actors that send."""

    def __init__(self) -> None:
        self._heard: dict[str, float] = {}
        self._forgot_at = -math.inf  # when silent actors were left out

    def hear(self, actor: str) -> None:
        """An actor has sent something."""
        self._heard[actor] = time.monotonic()

    def of_each(self) -> int:
        """Return how many chunks each actor may have under way; at least 1."""
        if time.monotonic() - self._forgot_at >= FORGET_SECONDS:
            self._forget_silent_actors()
        return max(1, min(CREDITS, QUEUE_CAPACITY // max(1, len(self._heard))))

    def active_actors(self) -> int:
        """Return how many actors were heard in the last ten seconds."""
        self._forget_silent_actors()
        return len(self._heard)

    def _forget_silent_actors(self) -> None:
        now = time.monotonic()
        self._heard = {actor: heard for actor, heard in self._heard.items() if now - heard < ACTIVE_SECONDS}
        self._forgot_at = now
