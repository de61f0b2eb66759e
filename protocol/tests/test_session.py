"""Sessions: wrong addresses and absent learners are one line, soon; nothing hangs and nothing is printed."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Callable

import pytest
import zenoh
from athrl_protocol import AddressInUse, LearnerNotFound, ProtocolError, complete_address, open_session
from athrl_protocol.transport.address import split_address

PATIENCE = 30.0
Open = Callable[[], zenoh.Session]


def _one_line(caught: pytest.ExceptionInfo[ProtocolError]) -> str:
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_port_in_use_by_a_learner_is_named_at_once(address: str, listen: Open) -> None:
    listen()
    with pytest.raises(AddressInUse) as caught:
        open_session(listen=address, timeout=PATIENCE)
    assert _one_line(caught).startswith(f"{address} is in use")


def test_port_in_use_by_another_program_is_named_at_once() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        address = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(AddressInUse, match=f"{address} is in use"):
            open_session(listen=address, timeout=PATIENCE)


def test_learner_can_listen_again_at_the_port_it_had(address: str, listen: Open, connect: Open) -> None:
    for _ in range(3):
        session = listen()
        connect()
        session.close()


def test_absent_learner_is_named_after_the_timeout(address: str) -> None:
    with pytest.raises(LearnerNotFound) as caught:
        open_session(connect=address, timeout=0.3)
    text = _one_line(caught)
    assert text.startswith(f"no learner at {address} within 0.3 s (no process listens there)")
    assert "--connect" in text


def test_listener_without_an_answer_may_be_a_paused_learner_or_none() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(LearnerNotFound, match="there does not answer: a learner that is paused"):
            open_session(connect=f"127.0.0.1:{other.getsockname()[1]}", timeout=0.1)


def test_unknown_host_is_named() -> None:
    with pytest.raises(LearnerNotFound, match=r"the name nowhere.invalid is not known"):
        open_session(connect="tcp/nowhere.invalid:7447", timeout=0.1)
    with pytest.raises(ProtocolError, match=r"cannot listen at tcp/nowhere.invalid:7447"):
        open_session(listen="tcp/nowhere.invalid:7447", timeout=0.1)


def test_address_of_another_machine_cannot_be_listened_at() -> None:
    with pytest.raises(ProtocolError, match=r"cannot listen at tcp/192.0.2.1:7447"):
        open_session(listen="tcp/192.0.2.1:7447", timeout=0.1)


@pytest.mark.parametrize("address", ["", "7447", "tcp/7447", "tcp/host:", "tcp/:7447", "udp/a:1", "a:x"])
def test_what_is_no_address_is_refused_with_an_example(address: str) -> None:
    for place in ({"listen": address}, {"connect": address}):
        with pytest.raises(ProtocolError, match=r"should look like tcp/127.0.0.1:7447"):
            open_session(timeout=PATIENCE, **place)


@pytest.mark.parametrize("address", ["tcp/a:0", "a:65536", "tls/a:99999", "tcp/a:" + "9" * 5000])
def test_port_that_there_is_not_is_refused_with_those_that_there_are(address: str) -> None:
    with pytest.raises(ProtocolError, match=r"its port should be 1 to 65535$"):
        complete_address(address, secure=True)


def test_client_waits_for_a_learner_that_comes_later(address: str) -> None:
    opened: list[zenoh.Session] = []
    timer = threading.Timer(0.3, lambda: opened.append(open_session(listen=address, timeout=PATIENCE)))
    timer.start()
    try:
        open_session(connect=address, timeout=PATIENCE).close()
    finally:
        timer.join()
        opened[0].close()


def test_waiting_for_a_learner_can_be_given_up(address: str) -> None:
    stop = threading.Event()
    stop.set()
    with pytest.raises(LearnerNotFound):
        open_session(connect=address, timeout=3600, stop=stop)


def test_learner_listens_at_its_address_only(address: str, listen: Open) -> None:
    session = listen()
    port = int(address.rpartition(":")[2])
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", port), timeout=PATIENCE)
    assert session.info.peers_zid() == []


def test_nothing_is_printed_when_links_break(address: str) -> None:
    script = """
import sys
from athrl_protocol import LearnerNotFound, LatestSubscriber, open_session
learner = open_session(listen=sys.argv[1], timeout=30)
client = open_session(connect=sys.argv[1], timeout=30)
subscriber = LatestSubscriber(client, "athrl/a/b", print)
learner.close()
try:
    open_session(connect=sys.argv[1], timeout=0.1)
except LearnerNotFound:
    pass
client.close()
subscriber.close()
"""
    ended = subprocess.run(
        [sys.executable, "-c", script, address], capture_output=True, timeout=PATIENCE, check=True
    )
    assert ended.stdout == b""
    assert ended.stderr == b""


@pytest.mark.parametrize(
    "host", ["a..b", "a" * 64, "a\0b", "a b", "a\tb", "a." * 150, "\ud800", ""], ids=repr
)
def test_host_that_nobody_can_look_up_is_no_address(host: str) -> None:
    with pytest.raises(ProtocolError, match="is not an address"):
        split_address(f"tcp/{host}:7447")


@pytest.mark.parametrize("host", ["learner", "a.b.", "127.0.0.1", "[::1]", "[fe80::1%eth0]", "münchen.de"])
def test_host_that_can_be_looked_up_is_one(host: str) -> None:
    assert split_address(f"tcp/{host}:7447") == (host.strip("[]"), 7447)
