"""Services find their learner by the run's folder, and keep their session when it comes back elsewhere."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import typer
from athrl.errors import CommandError
from athrl.rendezvous.following import TRY_AGAIN, follow
from athrl.rendezvous.listening import at_free_port
from athrl.rendezvous.relay import Relay
from athrl.rendezvous.run_folder import learner_address, run_named
from athrl_protocol import LearnerNotFound, ProtocolError, RunFile, open_session
from athrl_protocol.announcements.address_file import ADDRESS_FILE, read_address
from athrl_protocol.security.certificates import VARIABLE

PATIENCE = 20.0
KEY = "athrl/test/moved"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of a run."""
    place = tmp_path / "town03"
    place.mkdir()
    return place


def test_session_stays_open_while_its_learner_moves(folder: Path, free_address: Callable[[], str]) -> None:
    file, heard = folder / ADDRESS_FILE, threading.Event()
    with Relay(partial(read_address, folder)) as relay:
        first = free_address()
        file.write_text(first)
        with (
            open_session(listen=first, timeout=PATIENCE) as learner,
            open_session(connect=relay.address, timeout=PATIENCE) as client,
        ):
            client.declare_subscriber(KEY, lambda sample: heard.set())
            _say_until(learner, heard)
            learner.close()
            heard.clear()
            second = free_address()
            file.write_text(second)
            with open_session(listen=second, timeout=PATIENCE) as elsewhere:
                _say_until(elsewhere, heard)


def _say_until(session, heard: threading.Event) -> None:
    deadline = time.monotonic() + PATIENCE
    while not heard.wait(0.05):
        assert time.monotonic() < deadline
        session.put(KEY, b"here")


def test_relay_passes_everything_on_both_ways_and_the_end_too(folder: Path) -> None:
    sent = os.urandom(300_000)
    with socket.create_server(("127.0.0.1", 0)) as learner, Relay(partial(read_address, folder)) as relay:
        (folder / ADDRESS_FILE).write_text(f"tcp/127.0.0.1:{learner.getsockname()[1]}")
        with _connected(relay) as client:
            there, _ = learner.accept()
            with there:
                threading.Thread(target=client.sendall, args=(sent,)).start()
                assert _received(there, len(sent)) == sent
                threading.Thread(target=there.sendall, args=(sent,)).start()
                assert _received(client, len(sent)) == sent
            assert client.recv(1) == b""


@pytest.mark.parametrize("named", [None, "tcp/127.0.0.1:1", "no address"])
def test_relay_without_a_learner_closes_connections(folder: Path, named: str | None) -> None:
    if named is not None:
        (folder / ADDRESS_FILE).write_text(named)
    with Relay(partial(read_address, folder)) as relay, _connected(relay) as client:
        assert client.recv(1) == b""


def test_relay_ends_though_the_folder_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, answers = threading.Event(), threading.Event()

    def find() -> None:
        asked.set()
        answers.wait(PATIENCE)

    monkeypatch.setattr("athrl.rendezvous.relay.CLOSE_SECONDS", 0.2)
    with Relay(find) as relay, _connected(relay):
        assert asked.wait(PATIENCE)
    assert not answers.is_set()
    answers.set()


def _connected(relay: Relay) -> socket.socket:
    host, _, port = relay.address.partition(":")
    return socket.create_connection((host, int(port)), timeout=PATIENCE)


def _received(source: socket.socket, count: int) -> bytes:
    received = b""
    while len(received) < count and (piece := source.recv(count)):
        received += piece
    return received


def test_service_without_a_learner_ends_with_try_again(folder: Path, capsys) -> None:
    def serve(address: str, over: threading.Event) -> None:
        raise LearnerNotFound("no learner")

    with pytest.raises(typer.Exit) as left:
        follow(str(folder), threading.Event(), serve)
    assert left.value.exit_code == TRY_AGAIN == 75
    assert capsys.readouterr().err == (
        f"athrl: {folder} names no learner, and none answers; ending with 75: try again later\n"
    )


def test_service_leaves_a_learner_that_is_silent_for_long(folder: Path, capsys) -> None:
    (folder / ADDRESS_FILE).write_text("tls/node-7:7447")
    with pytest.raises(typer.Exit) as left:
        follow(str(folder), threading.Event(), lambda _, over: over.wait(PATIENCE), silent_seconds=0.3)
    assert left.value.exit_code == TRY_AGAIN
    assert "last at tls/node-7:7447, and has not answered for 0.3 s" in capsys.readouterr().err


def test_service_that_is_stopped_ends_well(folder: Path) -> None:
    stop = threading.Event()
    threading.Timer(0.2, stop.set).start()
    follow(str(folder), stop, lambda _, over: over.wait(PATIENCE))
    assert stop.is_set()


def test_address_is_used_as_it_is() -> None:
    given = []
    follow("tcp/10.0.0.7:7447", threading.Event(), lambda address, _: given.append(address))
    assert given == ["tcp/10.0.0.7:7447"] == [learner_address("tcp/10.0.0.7:7447")]
    assert run_named("tcp/10.0.0.7:7447", "asked") == "asked"


def test_folder_stands_for_address_certificates_and_name(folder: Path, monkeypatch) -> None:
    monkeypatch.setenv(VARIABLE, "")
    monkeypatch.delenv(VARIABLE)  # and after the test, too
    (folder / ADDRESS_FILE).write_text("tls/node-7:7447\n")
    (folder / "certificates").mkdir()
    assert learner_address(str(folder)) == "tls/node-7:7447"
    assert os.environ[VARIABLE] == str(folder / "certificates")
    assert run_named(str(folder), "another") == "town03"


def test_certificates_that_are_given_are_kept(folder: Path, monkeypatch) -> None:
    monkeypatch.setenv(VARIABLE, "/mine")
    (folder / "certificates").mkdir()
    run_named(str(folder), "town03")
    assert os.environ[VARIABLE] == "/mine"


@pytest.mark.parametrize("given", ["/no/such/folder", "./runs/town03", "runs/town03"])
def test_missing_folder_is_named(given: str) -> None:
    with pytest.raises(CommandError, match=f"--connect {given}: there is no such folder of a run"):
        learner_address(given)


def test_folder_without_a_learner_is_named(folder: Path) -> None:
    with pytest.raises(CommandError, match=f"no learner runs there: {folder} has no learner.address"):
        learner_address(str(folder))


def test_learner_takes_the_next_free_port(free_address: Callable[[], str]) -> None:
    taken = free_address()
    with open_session(listen=taken, timeout=PATIENCE):
        settings = RunFile.model_validate({"network": {"listen": taken}})
        listen = at_free_port(settings, "node-7", secure=False).network.listen
    assert listen.startswith("tcp/127.0.0.1:")
    assert int(listen.rpartition(":")[2]) > int(taken.rpartition(":")[2])


def test_learner_is_told_of_a_wrong_host_before_it_starts() -> None:
    with pytest.raises(ProtocolError, match="'node 7' should be a host name"):
        at_free_port(RunFile(), "node 7", secure=False)
