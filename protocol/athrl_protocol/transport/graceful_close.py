"""Closes a session without blocking other clients.

If a client closes its session while a router is passing a message to it, the router is blocked for
`wait_before_close`, five seconds: the thread that passes the message waits for room in the client's queue and
holds its lock, and the thread that sends to all clients waits for that lock to empty the queue (Zenoh 1.10,
`StageIn.push_network_message` and `TransmissionPipelineConsumer.drain`). So a client first undeclares its
subscriptions, then makes a query, whose answer arrives after all messages that were in flight, and then
closes. It makes a second query a moment later: a router that sends a message to its clients one after the
other may reach this one only then.
"""

from __future__ import annotations

import contextlib
import time
from typing import Any, cast

import zenoh

from athrl_protocol.messages.keys import EVERY_RUN_FILE

_ANSWER_SECONDS = 2.0
_SECOND_ROUND_SECONDS = 0.25


def drain_incoming(session: zenoh.Session) -> None:
    """Wait until all messages to this client have arrived; call it without subscriptions, before `close`.

    Takes at most four seconds, if there is no answer.
    """
    with contextlib.suppress(zenoh.ZError):  # the session is closed, or has lost its connection
        _round_trip(session)
        time.sleep(_SECOND_ROUND_SECONDS)
        _round_trip(session)


def _round_trip(session: zenoh.Session) -> None:
    for _ in session.get(EVERY_RUN_FILE, timeout=_ANSWER_SECONDS):
        pass


def closed_gracefully(session: zenoh.Session) -> zenoh.Session:
    """The session, for a `with` block that ends by calling `close`.

    Zenoh's own end of such a block raises RuntimeError ("Already borrowed") while another thread is inside
    one of the session's calls, as the connection monitor may be; `close` does not.
    """
    return cast(zenoh.Session, _Closing(session))


class _Closing:
    """Behaves as the session otherwise; inside the block it is the session itself."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)

    def __enter__(self) -> zenoh.Session:
        return self._session

    def __exit__(self, *_: object) -> None:
        self._session.close()
