"""Leave a session so that nobody else is held up.

A router that is just handing a message to a client when the client closes its session stands still for
`wait_before_close`, five seconds: who hands over waits for room in the client's queue and holds its lock,
and the thread that sends for all of the router's clients waits for that lock, to empty the queue (Zenoh
1.10, `StageIn.push_network_message` and `TransmissionPipelineConsumer.drain`). So a client first takes back
its subscriptions, then has a question answered, behind whatever was on its way, and then closes. It asks
once more a moment later: who hands a message to one client after the other may come to this one only then.
"""

from __future__ import annotations

import contextlib
import time
from typing import Any, cast

import zenoh

from athrl_protocol.keys import EVERY_RUN_FILE

_ANSWER_SECONDS = 2.0
_OTHERS_SECONDS = 0.25


def await_what_is_on_its_way(session: zenoh.Session) -> None:
    """Wait until what was sent to this client has come; call it without subscriptions, before `close`.

    Takes four seconds at most, if nobody answers.
    """
    with contextlib.suppress(zenoh.ZError):  # the session is closed, or has lost its connection
        _have_answered(session)
        time.sleep(_OTHERS_SECONDS)
        _have_answered(session)


def _have_answered(session: zenoh.Session) -> None:
    for _ in session.get(EVERY_RUN_FILE, timeout=_ANSWER_SECONDS):
        pass


def closing_at_the_end(session: zenoh.Session) -> zenoh.Session:
    """The session, for a `with` block that ends by calling `close`.

    Zenoh's own end of such a block raises RuntimeError ("Already borrowed") while another thread is inside
    one of the session's calls, as the one that looks after connections may be; `close` does not.
    """
    return cast(zenoh.Session, _Closing(session))


class _Closing:
    """A session in every other respect; inside of the block it is the session itself."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)

    def __enter__(self) -> zenoh.Session:
        return self._session

    def __exit__(self, *_: object) -> None:
        self._session.close()
