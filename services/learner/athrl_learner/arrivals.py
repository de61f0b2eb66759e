"""Which actor sent how much, and how old the policy was that it drove with."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from athrl_protocol import Chunk

#: An actor that was silent for so many seconds is no longer reported.
SILENCE = 60.0


@dataclass
class _Actor:
    transitions: int
    policy_lag: int  # versions, at its last chunk
    heard_at: float


class Arrivals:
    """Keeps the newest facts of each actor. Not thread-safe: the store calls it under its lock."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.published_version = 0
        self._clock = clock
        self._actors: dict[str, _Actor] = {}

    def arrived(self, chunk: Chunk) -> None:
        """Note an accepted chunk."""
        actor = self._actors.setdefault(chunk.actor, _Actor(0, 0, 0.0))
        actor.transitions += chunk.length
        # A version above the published one belongs to the time before a learner was killed.
        actor.policy_lag = max(0, self.published_version - int(chunk.policy_version[chunk.length - 1]))
        actor.heard_at = self._clock()

    def metrics(self) -> dict[str, float]:
        """`policy_lag` of the worst actor; `policy_lag/NAME` and `transitions/NAME` of each that is heard."""
        now = self._clock()
        self._actors = {
            name: actor for name, actor in self._actors.items() if now - actor.heard_at <= SILENCE
        }
        values = {"policy_lag": float(max((actor.policy_lag for actor in self._actors.values()), default=0))}
        for name, actor in self._actors.items():
            values[f"policy_lag/{name}"] = float(actor.policy_lag)
            values[f"transitions/{name}"] = float(actor.transitions)
        return values
