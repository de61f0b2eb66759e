"""Present services: a liveliness token for each, which disappears with its process or connection."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Set

import zenoh

from athrl_protocol.faults.background import Background
from athrl_protocol.messages.keys import Keys, is_name, role_and_name_of
from athrl_protocol.transport.closeable import Closeable
from athrl_protocol.transport.session import undeclare_quietly

MOST_AT_ONCE = 256  # events between two polls; with more of them the session would wait
MOST_PRESENT = 20_000  # services of a run; of further tokens, which anybody may make up, nothing is kept

_log = logging.getLogger(__name__)


class Presence(Closeable):
    """A declared token; the service counts as present until it is closed or its session ends."""

    def __init__(self, token: zenoh.LivelinessToken) -> None:
        self._token = token

    def close(self) -> None:
        """Remove the token."""
        undeclare_quietly(self._token)


def announce_presence(session: zenoh.Session, run: str, role: str, name: str) -> Presence:
    """Announce that the service `name` of the role (learner, actor, evaluator) is present."""
    return Presence(session.liveliness().declare_token(Keys(run).alive(role, name)))


class PresenceWatcher(Closeable):
    """Keeps the set of present services of a run; their names are taken.

    Args:
        session: an open session, which stays the caller's.
        run: name of the run.
        on_change: called with the new set after each change, from another thread.

    A thousand services that watch each other cause a million messages: `PresencePoll` can watch one of them.

    Errors in the other thread are logged, and raised as BackgroundFailed by `present` and `wait_for`.
    """

    def __init__(
        self,
        session: zenoh.Session,
        run: str,
        on_change: Callable[[frozenset[tuple[str, str]]], None] | None = None,
    ) -> None:
        self._on_change = on_change
        self._changed = threading.Condition()
        self._background = Background("the watch over present services", _log, wake=self._wake)
        self._present: set[tuple[str, str]] = set()
        # With history, because a query for tokens can come back empty behind a router.
        self._subscriber = session.liveliness().declare_subscriber(
            Keys(run).every_alive, self._take, history=True
        )

    def present(self) -> set[tuple[str, str]]:
        """Return (role, name) of all present services."""
        with self._changed:
            self._background.check()
            return set(self._present)

    def wait_for(self, condition: Callable[[Set[tuple[str, str]]], bool], timeout: float) -> bool:
        """Wait at most `timeout` seconds until the set fulfils the condition; return whether it does.

        The condition must not keep the set, which changes.
        """
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
        if not all(map(is_name, service)):
            return  # a stranger's, whose signs would come into the log and onto the screen
        with self._changed:
            comes = sample.kind == zenoh.SampleKind.PUT
            if comes == (service in self._present) or (comes and len(self._present) >= MOST_PRESENT):
                return
            if comes:
                self._present.add(service)
            else:
                self._present.remove(service)
            self._changed.notify_all()
            present = frozenset(self._present) if self._on_change is not None else None
        if self._on_change is not None and present is not None:
            self._on_change(present)


class PresencePoll(Closeable):
    """Whether a service of a role, or one by its name, is present; for callers that only poll a few times.

    It costs a tenth of a watcher, because it has no callbacks. Of two such objects in one session the first
    is up to date as soon as the second sees a service.
    """

    def __init__(self, session: zenoh.Session, run: str, role: str, name: str | None = None) -> None:
        self._present: set[str] = set()
        keys = Keys(run)
        self._subscriber = session.liveliness().declare_subscriber(
            keys.alive_of(role) if name is None else keys.alive(role, name),
            zenoh.handlers.FifoChannel(MOST_AT_ONCE),
            history=True,
        )

    def any_present(self) -> bool:
        """Poll once."""
        while (event := self._subscriber.handler.try_recv()) is not None:
            self._note(event)
        return bool(self._present)

    def close(self) -> None:
        """Stop polling."""
        undeclare_quietly(self._subscriber)

    def _note(self, event: zenoh.Sample) -> None:
        """Add or remove a service; the same event may come twice."""
        change = self._present.add if event.kind == zenoh.SampleKind.PUT else self._present.discard
        change(str(event.key_expr))
