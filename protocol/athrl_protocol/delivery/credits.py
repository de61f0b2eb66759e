"""How many chunks each actor may have in flight, from the number of active actors. No network, no threads."""

from __future__ import annotations

import math
import time

# Queries that may wait at the learner. A full queue would block everything else on the link, so the credits
# of all actors together stay below it.
QUEUE_CAPACITY = 256
# Most credits of one actor: enough that neither side waits for the other on a busy machine or slow network.
CREDITS = 32
ACTIVE_SECONDS = 10.0
# Seconds between searches for silent actors; a search for every chunk would be too costly.
FORGET_SECONDS = 0.5


class Credits:
    """Shares the learner's queue among the actors that send."""

    def __init__(self) -> None:
        self._last_seen: dict[str, float] = {}
        self._forgot_at = -math.inf  # when silent actors were last removed

    def note_message(self, actor: str) -> None:
        """Note that an actor has sent a message."""
        self._last_seen[actor] = time.monotonic()

    def per_actor(self) -> int:
        """Return how many chunks each actor may have in flight; at least 1."""
        if time.monotonic() - self._forgot_at >= FORGET_SECONDS:
            self._forget_silent_actors()
        return max(1, min(CREDITS, QUEUE_CAPACITY // max(1, len(self._last_seen))))

    def active_actors(self) -> int:
        """Return how many actors sent a message in the last ten seconds."""
        self._forget_silent_actors()
        return len(self._last_seen)

    def _forget_silent_actors(self) -> None:
        now = time.monotonic()
        self._last_seen = {
            actor: seen for actor, seen in self._last_seen.items() if now - seen < ACTIVE_SECONDS
        }
        self._forgot_at = now
