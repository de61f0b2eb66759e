"""Questions that the learner answers: what was changed in the run's settings, and names that are free."""

from __future__ import annotations

import itertools
import json
import logging
import threading
import time
from collections.abc import Callable, Collection, Sequence

import zenoh
from athrl_spaces.untrusted import one_line

from athrl_protocol.announcements.presence import PresenceWatcher
from athrl_protocol.errors import InvalidMessage, LearnerNotFound, ProtocolError
from athrl_protocol.faults.refusals import OTHERS, Refusals
from athrl_protocol.messages.keys import Keys, check_name
from athrl_protocol.transport.closeable import Closeable
from athrl_protocol.transport.session import address_of, undeclare_quietly

QUERY_SECONDS = 1.0
PAUSE_SECONDS = 0.1
RESERVED_SECONDS = 30.0  # for which a name that was given is kept for a service that does not show itself yet
MOST_HOSTS = 4096
MOST_CHANGES = 20  # that are told, the newest ones
LONGEST_CHANGE = 2_000  # characters

_log = logging.getLogger(__name__)


class _Answers(Closeable):
    """Answers the queries of a key; one that `answer` refuses with ProtocolError gets none."""

    def __init__(self, session: zenoh.Session, key: str, answer: Callable[[bytes], bytes]) -> None:
        self._key = key
        self._answer = answer
        self._refusals = Refusals("a question", _log)
        self._queryable = session.declare_queryable(key, self._reply, complete=True)

    def close(self) -> None:
        """Stop answering."""
        undeclare_quietly(self._queryable)

    def _reply(self, query: zenoh.Query) -> None:
        with query:
            try:
                answer = self._answer(query.payload.to_bytes() if query.payload is not None else b"")
            except ProtocolError as error:
                self._refusals.add(OTHERS, InvalidMessage("value", f"{self._key}: {error}"))
            else:
                query.reply(self._key, answer)


def serve_changes(session: zenoh.Session, run: str, changes: Sequence[str]) -> Closeable:
    """Tell who asks how the run's settings were changed, in one line each, until the result is closed."""
    payload = json.dumps([one_line(line)[:LONGEST_CHANGE] for line in changes[-MOST_CHANGES:]]).encode()
    return _Answers(session, Keys(run).changes, lambda _: payload)


def fetch_changes(session: zenoh.Session, run: str) -> list[str]:
    """Query the learner for the newest changes of the run's settings; empty without an answer.

    Raises:
        InvalidMessage: the answer is no list of lines.
    """
    answer = _ask(session, Keys(run).changes, b"")
    try:
        lines = json.loads(answer) if answer is not None else []
    except (ValueError, RecursionError):
        raise InvalidMessage("malformed", "changes of the settings: no JSON") from None
    if not isinstance(lines, list) or len(lines) > MOST_CHANGES:
        raise InvalidMessage("value", f"changes of the settings: no list of at most {MOST_CHANGES} lines")
    if not all(
        isinstance(line, str) and len(line) <= LONGEST_CHANGE and line.isprintable() for line in lines
    ):
        raise InvalidMessage("value", "changes of the settings: a line is no printable text")
    return lines


class FreeNames(Closeable):
    """Gives names to services of a role that have none: the lowest free one of `actor-1`, `actor-2`, ...

    So names, and with them curves, are the same when containers are made anew. A host gets its former name
    again if that is free.

    Args:
        session: the learner's session.
        run: name of the run.
        role: whose names are given.
        presence: knows which names are taken.
        bound: names that are never free, as certificates are bound to them.
    """

    def __init__(
        self,
        session: zenoh.Session,
        run: str,
        role: str,
        presence: PresenceWatcher,
        bound: Collection[str] = (),
    ) -> None:
        self._role = role
        self._bound = frozenset(bound)
        self._presence = presence
        self._given: dict[str, tuple[str, float]] = {}  # host -> name and when, in the order of time
        self._lock = threading.Lock()
        self._answers = _Answers(session, Keys(run).free_name(role), self._answer)

    def close(self) -> None:
        """Stop giving names."""
        self._answers.close()

    def _answer(self, question: bytes) -> bytes:
        try:
            host = check_name("host", question.decode())
        except UnicodeDecodeError:
            raise ProtocolError("a host's name is no text") from None
        return self._name_for(host).encode()

    def _name_for(self, host: str) -> str:
        present = {name for role, name in self._presence.present() if role == self._role}
        with self._lock:
            now = time.monotonic()
            former = self._given.pop(host, ("", now))[0]
            reserved = {name for name, at in self._given.values() if now - at < RESERVED_SECONDS}
            taken = present | reserved | self._bound
            numbered = (f"{self._role}-{number}" for number in itertools.count(1))
            names = itertools.chain([former] if former else [], numbered)
            name = next(name for name in names if name not in taken)
            self._given[host] = (name, now)
            if len(self._given) > MOST_HOSTS:
                del self._given[next(iter(self._given))]
            return name


def ask_for_name(
    session: zenoh.Session, run: str, role: str, host: str, timeout: float, stop: threading.Event
) -> str | None:
    """Ask the learner for a free name for a service on that host; None if `stop` was set before.

    Raises:
        LearnerNotFound: the learner does not answer within `timeout` seconds.
        ProtocolError: its answer is no name.
    """
    deadline = time.monotonic() + timeout
    while not stop.is_set():
        answer = _ask(session, Keys(run).free_name(role), host.encode())
        if answer is not None:
            return check_name(role, answer.decode(errors="replace"))
        if time.monotonic() > deadline:
            raise LearnerNotFound(
                f"the learner at {address_of(session)} assigned no name within {timeout:g} s: "
                "choose one with --name"
            )
        stop.wait(PAUSE_SECONDS)
    return None


def _ask(session: zenoh.Session, key: str, question: bytes) -> bytes | None:
    for reply in session.get(key, payload=question, timeout=QUERY_SECONDS):
        if reply.ok is not None:
            return reply.ok.payload.to_bytes()
    return None
