"""Many who come at once get in, and so does who comes after those who have given up."""

from __future__ import annotations

import contextlib
import signal
import socket
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import zenoh
from athrl_protocol import open_session

SECONDS = 200.0
CROWD = 80
GIVEN_UP = 120
"""Zenoh accepts no connection for 0.1 s after each."""
TAKEN_IN = 8.0


def test_crowd_with_certificates_gets_in(
    learner: zenoh.Session, client: Callable[[str], zenoh.Session]
) -> None:
    with ThreadPoolExecutor(CROWD) as crowd:
        clients = list(crowd.map(client, ["actor"] * CROWD))
    assert len({str(session.info.zid()) for session in clients}) == CROWD


def test_learner_that_was_paused_is_not_held_up_by_those_who_came_meanwhile(
    command, tiny: list[str], port: int, ours: Path
) -> None:
    learner = command.start("learner", *tiny, "--set", "run.name=guarded", "--certificates", str(ours))
    command.wait_until_said(learner, "listens at", SECONDS)
    learner.send_signal(signal.SIGSTOP)
    with contextlib.ExitStack() as connections:
        for _ in range(GIVEN_UP):
            with contextlib.suppress(OSError):  # there is no room for it
                connections.enter_context(socket.create_connection(("127.0.0.1", port), timeout=0.02))
    learner.send_signal(signal.SIGCONT)
    address = f"tls/127.0.0.1:{port}"
    open_session(connect=address, timeout=TAKEN_IN, role="actor", certificates=ours / "actor").close()
