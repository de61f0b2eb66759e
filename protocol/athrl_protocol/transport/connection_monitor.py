"""Monitors the connections of all sessions of this process, a few times a second, in one thread.

It sets options of their sockets (`socket_options`) and replaces open connections that bring no answers
(`reconnection`). A polling thread is used, because callbacks on Zenoh's threads would wait for the
interpreter.
"""

from __future__ import annotations

import atexit
import contextlib
import logging
import threading
from typing import Any, NamedTuple

import zenoh

from athrl_protocol.faults.background import Background
from athrl_protocol.transport.reconnection import Reconnection
from athrl_protocol.transport.socket_options import Sockets

# Seconds between two polls; far below the lease.
POLL_SECONDS = 0.25
MOST_AT_ONCE = 4096  # events between two polls
END_SECONDS = 1.0  # longest duration of a poll

_log = logging.getLogger(__name__)


def monitor(session: zenoh.Session, reconnection: Reconnection | None = None) -> None:
    """Monitor the present and future connections of a session until it is closed.

    `reconnection` is for the connection that the session itself makes, if any.
    """
    channel: zenoh.handlers.FifoChannel[zenoh.LinkEvent] = zenoh.handlers.FifoChannel(MOST_AT_ONCE)
    _monitor.begin(_Session(session.info.declare_link_events_listener(channel, history=True), reconnection))


class _Session(NamedTuple):
    listener: Any
    reconnection: Reconnection | None

    def events(self) -> list[zenoh.LinkEvent] | None:
        """New events of its connections; None once the session is closed."""
        events = []
        try:
            while (event := self.listener.handler.try_recv()) is not None:
                events.append(event)
        except zenoh.ZError:
            return events or None
        return events

    def poll(self, events: list[zenoh.LinkEvent]) -> None:
        """Replace the connection if no answers arrive over it."""
        if self.reconnection is None:
            return
        self.reconnection.handle_events(events)
        with contextlib.suppress(zenoh.ZError):  # the session is being closed
            self.reconnection.poll()


class _Monitor:
    """The thread, which runs as long as there is a session."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sessions: list[_Session] = []
        self._sockets = Sockets()
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()

    def begin(self, session: _Session) -> None:
        """Add a session."""
        with self._lock:
            self._sessions.append(session)
            if len(self._sessions) == 1:
                self._thread = threading.Thread(target=self._run, name="connections", daemon=True)
                self._thread.start()

    def end(self) -> None:
        """End the thread before the interpreter ends, which would abort inside Zenoh."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(timeout=END_SECONDS)

    def _run(self) -> None:
        """Poll until the end; errors are logged."""
        background = Background("the monitor of connections", _log)
        while not self._ending.wait(POLL_SECONDS):
            with self._lock:
                polled = [(session, _events_of(session, background)) for session in self._sessions]
                self._sessions = [session for session, events in polled if events is not None]
                is_over = not self._sessions
            happened = [event for _, events in polled for event in events or ()]
            with background.watched():
                if happened:
                    self._sockets.update(happened)
            for session, events in polled:
                if events is not None:
                    with background.watched():
                        session.poll(events)
            if is_over:
                return


def _events_of(session: _Session, background: Background) -> list[zenoh.LinkEvent] | None:
    """New events of a session; none if they cannot be read, as it may still be there."""
    with background.watched():
        return session.events()
    return []


_monitor = _Monitor()
atexit.register(_monitor.end)
