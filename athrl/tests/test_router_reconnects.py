"""A router reconnects to a learner that is connected and does not answer, and to one that has moved."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh
from athrl_protocol import (
    Phase,
    RunFile,
    RunState,
    StatePublisher,
    fetch_run_file,
    open_session,
    read_run_file,
    serve_run_file,
)
from athrl_protocol.announcements.address_file import ADDRESS_FILE

PATIENCE = 60.0
RUN = "routed"
STATE = RunState(Phase.TRAINING, 1, 2, 0, 0)


class _Learner:
    """Says what a router listens to, and can be told to say nothing; counts how often the router came."""

    def __init__(self, address: str, run_file: RunFile, stack: ExitStack) -> None:
        self.came = 0
        session = stack.enter_context(open_session(listen=address, timeout=PATIENCE))
        # With history: the router may connect before the listener is declared.
        session.info.declare_transport_events_listener(self._hear, history=True)
        self._session, self._run_file = session, run_file
        self._state = stack.enter_context(StatePublisher(session, RUN))
        self.answer()
        stop, thread = threading.Event(), threading.Thread(target=lambda: self._tell(stop), daemon=True)
        thread.start()
        stack.callback(lambda: (stop.set(), thread.join(PATIENCE)))
        stack.callback(self.fall_silent)

    def answer(self) -> None:
        """Answer from now on."""
        self._served = serve_run_file(self._session, self._run_file)
        self._talks = True

    def fall_silent(self) -> None:
        """Answer nothing any more."""
        self._talks = False
        self._served.close()

    def _tell(self, stop: threading.Event) -> None:
        while not stop.wait(0.2):
            if self._talks:
                self._state.publish(STATE)

    def _hear(self, event: zenoh.TransportEvent) -> None:
        is_router = event.transport.whatami == zenoh.WhatAmI.ROUTER
        self.came += is_router and event.kind == zenoh.SampleKind.PUT


@pytest.fixture
def learner(address: str) -> Iterator[tuple[str, _Learner]]:
    with ExitStack() as stack:
        yield address, _Learner(address, read_run_file(None, [f"run.name={RUN}"]), stack)


def _await(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.timeout(240)
def test_router_connects_anew_to_a_learner_that_is_there_and_silent(
    learner: tuple[str, _Learner], free_address: Callable[[], str]
) -> None:
    address, there = learner
    words = ["router", "--listen", free_address(), "--connect", address, "--run", RUN]
    router = subprocess.Popen([sys.executable, "-m", "athrl", *words], stderr=subprocess.PIPE, text=True)
    try:
        _await(lambda: there.came == 1)
        time.sleep(6.0)
        assert there.came == 1  # one that speaks is left alone
        there.fall_silent()
        _await(lambda: there.came > 1)
        there.answer()
        time.sleep(6.0)
        came = there.came
        time.sleep(6.0)
        assert there.came == came
        router.send_signal(signal.SIGTERM)
        told = router.communicate(timeout=PATIENCE)[1]
    finally:
        router.kill()
    assert router.returncode == 0
    assert f"{address} is connected and does not answer: reconnecting" in told


@pytest.mark.timeout(240)
def test_router_follows_the_learner_of_a_folder_to_another_address(
    tmp_path: Path, free_address: Callable[[], str]
) -> None:
    (folder := tmp_path / RUN).mkdir()
    run_file, at = read_run_file(None, [f"run.name={RUN}"]), free_address()
    words = ["router", "--listen", at, "--connect", str(folder)]
    with ExitStack() as first, ExitStack() as second:
        (folder / ADDRESS_FILE).write_text(address := free_address())
        there = _Learner(address, run_file, first)
        router = subprocess.Popen([sys.executable, "-m", "athrl", *words], stderr=subprocess.DEVNULL)
        second.callback(router.kill)
        _await(lambda: there.came > 0)
        first.close()
        (folder / ADDRESS_FILE).write_text(address := free_address())
        elsewhere = _Learner(address, run_file, second)
        _await(lambda: elsewhere.came > 0)
        client = second.enter_context(open_session(connect=at, timeout=PATIENCE))
        assert fetch_run_file(client, RUN, timeout=PATIENCE).run.name == RUN
        router.send_signal(signal.SIGTERM)
        assert router.wait(PATIENCE) == 0
