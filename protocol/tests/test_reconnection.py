"""A connection without answers is replaced; one with answers is kept."""

from __future__ import annotations

import contextlib
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
import zenoh
from athrl_protocol import open_session
from athrl_protocol.transport import connection_monitor, reconnection
from athrl_protocol.transport.session import open_router

PATIENCE = 60.0
LEASE = 60_000  # ms; nothing here is noticed because of it
LEFT_ALONE = 8.0
OPENED = 2  # connections: a probe, and the session's


class _OneWay:
    """Stands before who listens, and may let nothing back through the connections that it has."""

    def __init__(self, listener: str, stack: ExitStack) -> None:
        self.came = 0
        self._listener = listener.removeprefix("tcp/").rpartition(":")
        self._muted: set[socket.socket] = set()
        self._open: list[socket.socket] = []
        self._server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        self.address = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        stack.callback(self._close)
        threading.Thread(target=self._accept, daemon=True).start()

    def mute_present(self) -> None:
        """Let nothing back through those that are there now."""
        self._muted.update(self._open)

    def _close(self) -> None:
        for connection in (self._server, *self._open):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._server.accept()
                host, _, port = self._listener
                listener = socket.create_connection((host, int(port)))
                self._open += [client, listener]
                self.came += 1
                for source, sink in ((client, listener), (listener, client)):
                    threading.Thread(target=self._pump, args=(source, sink), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while piece := source.recv(2**16):
                if source not in self._muted:
                    sink.sendall(piece)
            sink.shutdown(socket.SHUT_RDWR)

    def await_coming(self, count: int) -> None:
        """Wait until so many connections have come."""
        deadline = time.monotonic() + PATIENCE
        while self.came < count:
            assert time.monotonic() < deadline
            time.sleep(0.02)


@pytest.fixture
def between(address: str) -> Iterator[_OneWay]:
    """What stands before a listener with a long lease, which serves no run."""
    settings = {
        "mode": "router",
        "listen/endpoints": [address],
        "scouting/multicast/enabled": False,
        "transport/link/tx/lease": LEASE,
    }
    configuration = zenoh.Config()
    for key, value in settings.items():
        configuration.insert_json5(key, json.dumps(value))
    with ExitStack() as stack:
        stack.enter_context(zenoh.open(configuration))
        yield _OneWay(address, stack)


def test_client_connects_anew_when_nothing_comes_back(
    between: _OneWay, caplog: pytest.LogCaptureFixture
) -> None:
    """As after Zenoh forgot whom to send to: the connection stands, and is as good as none."""
    with open_session(connect=between.address, timeout=PATIENCE) as session:
        subscriber = session.declare_subscriber("athrl/any")
        between.mute_present()
        between.await_coming(OPENED + 1)
        assert f"{between.address} is connected and does not answer: reconnecting" in caplog.text
        with open_session(connect=between.address, timeout=PATIENCE) as speaker:
            deadline = time.monotonic() + PATIENCE
            while subscriber.try_recv() is None:
                assert time.monotonic() < deadline
                speaker.put("athrl/any", b"")
                time.sleep(0.05)


def test_router_connects_anew_however_often_its_clients_come(between: _OneWay, other_address: str) -> None:
    """No learner of its run answers; what its clients connect says nothing about that."""
    with open_router(listen=other_address, connect=between.address, run="none"):
        deadline = time.monotonic() + PATIENCE
        while between.came < 2:
            assert time.monotonic() < deadline
            open_session(connect=other_address, timeout=PATIENCE).close()
            time.sleep(0.3)


def test_connection_that_answers_is_left_alone(between: _OneWay) -> None:
    """An answer that there is no such value is an answer as well."""
    with open_session(connect=between.address, timeout=PATIENCE):
        time.sleep(LEFT_ALONE)
        assert between.came == OPENED


def test_session_closes_while_its_connection_is_asked_about(
    between: _OneWay, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Zenoh refuses the end of a `with` block while another thread is inside the session."""
    monkeypatch.setattr(reconnection, "QUERY_INTERVAL_SECONDS", 0.0)
    monkeypatch.setattr(reconnection, "RETRY_SECONDS", 0.0)
    monkeypatch.setattr(connection_monitor, "POLL_SECONDS", 0.0)
    for _ in range(20):
        with open_session(connect=between.address, timeout=PATIENCE):
            time.sleep(0.05)


_CLIENT = """
import sys
from athrl_protocol import open_session
from athrl_protocol.transport.session import open_router
with open_session(connect=sys.argv[1], timeout=30):
    sys.stdin.read()
"""


def test_client_that_stood_still_keeps_its_connection(between: _OneWay) -> None:
    client = subprocess.Popen([sys.executable, "-c", _CLIENT, between.address], stdin=subprocess.PIPE)
    try:
        between.await_coming(OPENED)
        for _ in range(3):
            time.sleep(0.7)  # not always at the same place between two questions
            client.send_signal(signal.SIGSTOP)
            time.sleep(3.5)  # longer than an answer is waited for, shorter than the lease
            client.send_signal(signal.SIGCONT)
        time.sleep(1.0)
        assert between.came == OPENED
        client.communicate(timeout=PATIENCE)
    finally:
        client.kill()
    assert client.returncode == 0
