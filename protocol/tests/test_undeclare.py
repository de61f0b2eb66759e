"""Undeclaring does not wait: an object that another thread uses is left to the end of its session."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

import zenoh
from athrl_protocol.transport.session import undeclare_quietly

PATIENCE = 30.0
Open = Callable[[], zenoh.Session]


def test_what_another_thread_uses_can_be_closed(listen: Open) -> None:
    session = listen()
    subscriber = session.declare_subscriber("athrl/any", zenoh.handlers.FifoChannel(1))
    inside = threading.Event()

    def wait_for_news() -> None:
        inside.set()
        with contextlib.suppress(zenoh.ZError):
            subscriber.recv()

    user = threading.Thread(target=wait_for_news, daemon=True)
    user.start()
    assert inside.wait(PATIENCE)
    for _ in range(100):
        undeclare_quietly(subscriber)
    session.close()
    user.join(PATIENCE)
    assert not user.is_alive()
