"""Detects other processes that answer or publish under the learner's keys.

Without certificates everybody who reaches the learner may declare anything. A second answerer takes chunks
away, a second publisher replaces the policy or the state. Neither can be prevented then, but the learner can
notice it, because its own session routes everything, and publish its own values again as newer ones.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Iterable
from itertools import islice
from typing import Any

import zenoh

from athrl_protocol.announcements.latest_value import version_of
from athrl_protocol.announcements.policy import PolicyPublisher
from athrl_protocol.announcements.state import StatePublisher
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.faults.bounded_log import BoundedLog
from athrl_protocol.messages.keys import Keys
from athrl_protocol.transport.closeable import Closeable
from athrl_protocol.transport.session import undeclare_quietly

MOST_ACTORS_CHECKED = 1_000
"""Actors whose keys are checked; a key takes 7 microseconds."""

_log = logging.getLogger(__name__)


class RivalWatch(Closeable):
    """Counts and logs the rivals of the learner that has this session.

    Attributes:
        values: published by others under the learner's keys.
        answerers: keys that only the learner should answer and another did, each once while it stays.

    Args:
        session: the learner's session, which stays the caller's.
        run: name of the run.
        policies: the learner's publisher.
        states: the learner's publisher.
    """

    def __init__(
        self, session: zenoh.Session, run: str, policies: PolicyPublisher, states: StatePublisher
    ) -> None:
        self.values = 0
        self.answerers = 0
        self._session = session
        self._keys = Keys(run)
        self._publishers: dict[str, PolicyPublisher | StatePublisher] = {
            self._keys.policy: policies,
            self._keys.state: states,
        }
        self._published: dict[str, int] = {}  # by key: the newest incarnation of another publisher
        self._lock = threading.Lock()  # of what `_take` changes, which several threads call
        self._warn = BoundedLog(_log.warning)
        self._answered: set[str] = set()  # keys with a second answerer at the last check
        self._subscribers = [
            session.declare_subscriber(key, self._take, allowed_origin=zenoh.Locality.REMOTE)
            for key in (self._keys.policy, self._keys.state, self._keys.run_file)
        ]

    def check(self, actors: Iterable[str]) -> None:
        """Check who answers, and publish again what others have replaced.

        Does not wait for answers. Called about once a second with the names of all actors.
        """
        with self._lock:
            published, self._published = self._published, {}
        for key, publisher in self._publishers.items():
            if key in published:
                publisher.supersede(published[key])
        keys = self._keys
        answerable = [
            *(keys.policy, keys.state, keys.run_file, keys.changes, keys.free_name("actor")),
            keys.every_experience,
            *(keys.experience(name) for name in islice(actors, MOST_ACTORS_CHECKED)),
        ]
        answered = {key for key in answerable if self._has_other_answerer(key)}
        found = sorted(answered - self._answered)
        self._answered = answered
        if found:
            self.answerers += len(found)
            more = f" and {len(found) - 1} more keys" if len(found) > 1 else ""
            self._warn(f"another process answers at {found[0]}{more}: chunks that it acknowledges are lost")

    def close(self) -> None:
        """Stop watching."""
        for subscriber in self._subscribers:
            undeclare_quietly(subscriber)

    def _has_other_answerer(self, key: str) -> bool:
        # Only a question to this very key finds an answerer of the key alone; asking is not needed.
        querier = self._session.declare_querier(key, allowed_destination=zenoh.Locality.REMOTE)
        try:
            status: Any = querier.matching_status  # its type is not the declared one
            return bool(status.matching)
        finally:
            undeclare_quietly(querier)

    def _take(self, sample: zenoh.Sample) -> None:
        with self._lock:
            self.values += 1
            with contextlib.suppress(InvalidMessage):  # then nobody else takes it, either
                version, _ = version_of(sample)
                key = str(sample.key_expr)
                self._published[key] = max(version.incarnation, self._published.get(key, 0))
        self._warn(f"another process publishes under {sample.key_expr}: actors and evaluators may believe it")
