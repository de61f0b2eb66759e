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
