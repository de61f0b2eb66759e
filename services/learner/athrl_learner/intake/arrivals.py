"""How much each actor sent, how old its policy was, and whether this learner published it."""

from __future__ import annotations

import heapq
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from athrl_protocol import Chunk
from athrl_protocol.faults.bounded_log import BoundedLog

log = logging.getLogger(__name__)

#: Seconds without a chunk after which an actor is no longer reported.
SILENCE = 60.0
#: Publications whose times are kept; an older policy counts as old as the oldest of them.
_REMEMBERED = 1_000
#: Actors that are reported by name; a report with more of them would exceed its size limit.
NAMED = 100


@dataclass
class _Actor:
    transitions: int
    policy_lag: int  # versions, at its last chunk
    policy_lag_seconds: float  # since a newer version than the chunk's was published, when it arrived
    last_chunk_at: float


class Arrivals:
    """Keeps the newest values of each actor.

    Chunks arrive in the intake's thread, policies are published in the trainer's.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.published_version = 0
        self.unpublished = 0  # chunks with a version above the published one
        self._warn = BoundedLog(log.warning)
        self._published_at: dict[int, float] = {}  # by version, of this learner's publications
        self._clock = clock
        self._actors: dict[str, _Actor] = {}
        self._lock = threading.Lock()

    def published(self, version: int) -> None:
        """Record the publication of a policy."""
        with self._lock:
            self.published_version = version
            self._published_at[version] = self._clock()
            if len(self._published_at) > _REMEMBERED:
                del self._published_at[next(iter(self._published_at))]

    def arrived(self, chunk: Chunk) -> None:
        """Record an accepted chunk."""
        with self._lock:
            self._record(chunk)

    def _record(self, chunk: Chunk) -> None:
        newest = int(chunk.policy_version[: chunk.length].max())
        if newest > self.published_version:
            self.unpublished += 1
            self._warn(f"{chunk.actor} drives policy {newest}, which this learner did not publish")
        actor = self._actors.setdefault(chunk.actor, _Actor(0, 0, 0.0, 0.0))
        version = int(chunk.policy_version[chunk.length - 1])
        actor.transitions += chunk.length
        # Not below 0: a version above the published one is another process's.
        actor.policy_lag = max(0, self.published_version - version)
        actor.policy_lag_seconds = self._seconds_since_newer_than(version)
        actor.last_chunk_at = self._clock()

    def _seconds_since_newer_than(self, version: int) -> float:
        if version >= self.published_version or not self._published_at:
            return 0.0
        oldest = next(iter(self._published_at.values()))
        return self._clock() - self._published_at.get(version + 1, oldest)

    def metrics(self) -> dict[str, float]:
        """`policy_lag` and `policy_lag_seconds` of the worst actor, and the same of each active actor.

        These are `policy_lag/NAME`, `policy_lag_seconds/NAME` and `transitions/NAME`; of more than `NAMED`
        actors only those that are furthest behind.
        """
        with self._lock:
            return self._metrics()

    def _metrics(self) -> dict[str, float]:
        now = self._clock()
        self._actors = {
            name: actor for name, actor in self._actors.items() if now - actor.last_chunk_at <= SILENCE
        }
        actors = self._actors.values()
        values = {
            "policy_lag": float(max((actor.policy_lag for actor in actors), default=0)),
            "policy_lag_seconds": max((actor.policy_lag_seconds for actor in actors), default=0.0),
        }
        for name, actor in self._furthest_behind().items():
            values[f"policy_lag/{name}"] = float(actor.policy_lag)
            values[f"policy_lag_seconds/{name}"] = actor.policy_lag_seconds
            values[f"transitions/{name}"] = float(actor.transitions)
        return values

    def _furthest_behind(self) -> dict[str, _Actor]:
        if len(self._actors) <= NAMED:
            return self._actors
        lags = {name: (actor.policy_lag_seconds, actor.policy_lag) for name, actor in self._actors.items()}
        return {name: self._actors[name] for name in heapq.nlargest(NAMED, lags, key=lags.__getitem__)}
