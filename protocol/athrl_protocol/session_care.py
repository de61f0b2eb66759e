"""Looks after the connections of all sessions of this process, a few times a second, in one thread.

Their sockets are seen to (`socket_options`), and those that stand and bring nothing are made anew
(`reconnection`). In a thread that asks, as Zenoh's own, called back, would wait for the interpreter.
"""

from __future__ import annotations

import atexit
import contextlib
import logging
import threading
from typing import Any, NamedTuple

import zenoh

from athrl_protocol.background import Background
from athrl_protocol.reconnection import Reconnection
from athrl_protocol.socket_options import Sockets

# What happens within this time is seen to together; it is far below the lease, and enough to say goodbye in.
TOGETHER_SECONDS = 0.25
MOST_AT_ONCE = 4096  # events between two looks
END_SECONDS = 1.0  # the longest that a look takes

_log = logging.getLogger(__name__)


def look_after(session: zenoh.Session, reconnection: Reconnection | None = None) -> None:
    """Look after the connections of a session until it is closed, those that it has and those to come.

    `reconnection` is for the one that it makes itself, if it makes one.
    """
    channel: zenoh.handlers.FifoChannel[zenoh.LinkEvent] = zenoh.handlers.FifoChannel(MOST_AT_ONCE)
    _care.begin(_Session(session.info.declare_link_events_listener(channel, history=True), reconnection))


class _Session(NamedTuple):
    listener: Any
    reconnection: Reconnection | None

    def events(self) -> list[zenoh.LinkEvent] | None:
        """What has happened to its connections; None once the session is closed."""
        events = []
        try:
            while (event := self.listener.handler.try_recv()) is not None:
                events.append(event)
        except zenoh.ZError:
            return events or None
        return events

    def look(self, events: list[zenoh.LinkEvent]) -> None:
        """Have the connection made anew if nothing comes back over it."""
        if self.reconnection is None:
            return
        self.reconnection.hear(events)
        with contextlib.suppress(zenoh.ZError):  # the session is being closed
            self.reconnection.look()


class _Care:
    """The thread, which is there as long as there is a session."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sessions: list[_Session] = []
        self._sockets = Sockets()
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()

    def begin(self, session: _Session) -> None:
        """Look after one more."""
        with self._lock:
            self._sessions.append(session)
            if len(self._sessions) == 1:
                self._thread = threading.Thread(target=self._run, name="connections", daemon=True)
                self._thread.start()

    def end(self) -> None:
        """Have the thread end before the interpreter does, which would end it within Zenoh and abort."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(timeout=END_SECONDS)

    def _run(self) -> None:
        """Look again and again; what goes wrong once is logged."""
        background = Background("the look after connections", _log)
        while not self._ending.wait(TOGETHER_SECONDS):
            with self._lock:
                heard = [(session, session.events()) for session in self._sessions]
                self._sessions = [session for session, events in heard if events is not None]
                is_over = not self._sessions
            happened = [event for _, events in heard for event in events or ()]
            with background.watched():
                if happened:
                    self._sockets.follow(happened)
            for session, events in heard:
                if events is not None:
                    with background.watched():
                        session.look(events)
            if is_over:
                return


_care = _Care()
atexit.register(_care.end)
