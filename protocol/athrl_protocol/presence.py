"""Who is there: a liveliness token for each service, which goes when its process or its link does."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import zenoh

from athrl_protocol.background import Background
from athrl_protocol.closing import Closing
from athrl_protocol.keys import Keys, role_and_name_of
from athrl_protocol.session import undeclare_quietly

MOST_AT_ONCE = 256  # comings and goings between two glances; more would keep the session waiting

_log = logging.getLogger(__name__)


class Presence(Closing):
    """A declared token; the service counts as present until it is closed or its session ends."""

    def __init__(self, token: zenoh.LivelinessToken) -> None:
        self._token = token

    def close(self) -> None:
        """Leave."""
        undeclare_quietly(self._token)


def announce_presence(session: zenoh.Session, run: str, role: str, name: str) -> Presence:
    """Say that the service `name` of the role (learner, actor, evaluator) is there."""
    return Presence(session.liveliness().declare_token(Keys(run).alive(role, name)))


class PresenceWatcher(Closing):
    """Keeps the set of services that are present in a run; a name in it is taken.

    Args:
        session: an open session, which stays the caller's.
        run: name of the run.
        on_change: called with the new set after each change, from another thread.
        role: watch services of this role only.
        name: watch this one only, of that role. Each watcher is told of everybody it watches when it comes,
            so a thousand services that watch each other take a million messages.

    What goes wrong in the other thread is logged, and raised as BackgroundFailed by `present` and `wait_for`.
    """

    def __init__(
        self,
        session: zenoh.Session,
        run: str,
        on_change: Callable[[frozenset[tuple[str, str]]], None] | None = None,
        role: str | None = None,
        name: str | None = None,
    ) -> None:
        self._on_change = on_change
        self._changed = threading.Condition()
        self._background = Background("the watch over who is there", _log, wake=self._wake)
        self._present: frozenset[tuple[str, str]] = frozenset()
        # With history, because a query for tokens can come back empty behind a router.
        self._subscriber = session.liveliness().declare_subscriber(
            _watched(Keys(run), role, name), self._take, history=True
        )

    def present(self) -> set[tuple[str, str]]:
        """Return (role, name) of all services that are there."""
        with self._changed:
            self._background.check()
            return set(self._present)

    def wait_for(self, condition: Callable[[frozenset[tuple[str, str]]], bool], timeout: float) -> bool:
        """Wait at most `timeout` seconds until the set fulfils the condition; return whether it does."""
        with self._changed:
            reached = self._changed.wait_for(
                lambda: self._background.failed or condition(self._present), timeout
            )
            self._background.check()
            return reached

    def close(self) -> None:
        """Stop watching."""
        undeclare_quietly(self._subscriber)

    def _take(self, sample: zenoh.Sample) -> None:
        """Add or remove a service; the same event may come twice."""
        with self._background.watched():
            self._note(sample)

    def _wake(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _note(self, sample: zenoh.Sample) -> None:
        service = role_and_name_of(str(sample.key_expr))
        with self._changed:
            if sample.kind == zenoh.SampleKind.PUT:
                present = self._present | {service}
            else:
                present = self._present - {service}
            if present == self._present:
                return
            self._present = present
            self._changed.notify_all()
        if self._on_change is not None:
            self._on_change(present)


class PresenceGlance(Closing):
    """Whether anybody of a role is there, or one service of it, for who looks a few times and is done.

    A tenth of what a watcher costs, because nothing of it runs by itself. Of two glances in one session the
    one that was made first knows all that was to be known when the other sees somebody.
    """

    def __init__(self, session: zenoh.Session, run: str, role: str, name: str | None = None) -> None:
        self._present: set[str] = set()
        self._subscriber = session.liveliness().declare_subscriber(
            _watched(Keys(run), role, name), zenoh.handlers.FifoChannel(MOST_AT_ONCE), history=True
        )

    def is_anybody_there(self) -> bool:
        """Look once."""
        while (event := self._subscriber.handler.try_recv()) is not None:
            self._note(event)
        return bool(self._present)

    def close(self) -> None:
        """Look no more."""
        undeclare_quietly(self._subscriber)

    def _note(self, event: zenoh.Sample) -> None:
        """Add or remove a service; the same event may come twice."""
        change = self._present.add if event.kind == zenoh.SampleKind.PUT else self._present.discard
        change(str(event.key_expr))


def _watched(keys: Keys, role: str | None, name: str | None) -> str:
    if role is None:
        return keys.every_alive
    return keys.alive_of(role) if name is None else keys.alive(role, name)
