"""The audit finds each kind of loss, made on purpose."""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))  # tests is no installed package

import numpy as np
from athrl_learner.log import Kind, SegmentLog
from athrl_protocol import Chunk, InvalidMessage, LevelColumns, decode_chunk, encode_chunk
from athrl_protocol.delivery.upload_window import Reason, UploadWindow

from tests.chaos.audit import Account, actors_imbalances, compare, read_log
from tests.chaos.content import read_chunk
from tests.chaos.evidence import Evidence
from tests.chaos.flood import malformed_messages
from tests.chaos.link_proxy import HOST, Link, LinkProxies
from tests.chaos.outages import Outage, longest_stall
from tests.chaos.recording_actor import RecordingWindow
from tests.chaos.schedule import Fault, Group
from tests.chaos.schedule import Kind as FaultKind

CHUNKS = 6
WAIT = 0.3


def chunk(sequence: int) -> Chunk:
    """A chunk with unique content."""
    columns = LevelColumns(
        np.full((4, 1), sequence, np.float32), np.zeros(4, np.float32), np.zeros((1, 2), np.float32)
    )
    return Chunk(
        actor="a",
        incarnation=7,
        sequence=sequence,
        environment=0,
        episode_seed=sequence,
        first_step=0,
        length=4,
        state_interval=4,
        images=np.zeros((5, 4, 4, 4), np.uint8),
        motion=np.zeros((5, 2), np.float32),
        levels={"intention": columns},
        policy_version=np.zeros(4, np.int64),
        terminated=False,
        truncated=False,
    )


MESSAGES = [encode_chunk(chunk(sequence)) for sequence in range(CHUNKS)]


def account(folder: Path, written: list[bytes], acknowledged: int = CHUNKS) -> Account:
    """The audit of a log with these records, when all of MESSAGES were made."""
    experience = folder / "experience"
    experience.mkdir()
    log = SegmentLog(experience, segment_bytes=2**20, fsync="never", reserve_bytes=0)
    for message in written:
        log.append(Kind.CHUNK, message)
    log.close()
    lines = []
    for number, message in enumerate(MESSAGES):
        identity, content = read_chunk(message)
        words = " ".join(map(str, (*identity, *content)))
        lines.append(f"produced 1.0 {words}")
        if number < acknowledged:
            lines.append(f"acknowledged 2.0 {words}")
    (folder / "a.txt").write_text("\n".join(lines) + "\n" + lines[0][:20])
    evidence = Evidence(folder)
    evidence.read()
    return compare(evidence, read_log(experience))


def test_account_of_a_whole_log_balances(tmp_path: Path) -> None:
    assert account(tmp_path, MESSAGES) == Account(CHUNKS, CHUNKS, CHUNKS, 4 * CHUNKS, 0, 0, 0)


def test_chunk_that_is_stored_and_not_yet_acknowledged_is_no_loss(tmp_path: Path) -> None:
    found = account(tmp_path, MESSAGES, acknowledged=3)
    assert (found.acknowledged, found.lost, found.twice, found.foreign) == (3, 0, 0, 0)


def test_missing_chunk_is_lost(tmp_path: Path) -> None:
    assert account(tmp_path, MESSAGES[:2] + MESSAGES[3:]).lost == 1


def test_chunk_that_was_taken_twice_is_found(tmp_path: Path) -> None:
    assert account(tmp_path, [*MESSAGES, MESSAGES[2]]).twice == 1


def test_content_that_was_taken_under_two_names_is_found(tmp_path: Path) -> None:
    again = encode_chunk(replace(chunk(2), sequence=99))
    found = account(tmp_path, [*MESSAGES, again])
    assert (found.twice, found.foreign) == (2, 1)


def test_altered_chunk_is_lost_and_foreign(tmp_path: Path) -> None:
    other = encode_chunk(replace(chunk(2), environment=5))
    found = account(tmp_path, [*MESSAGES[:2], other, *MESSAGES[3:]])
    assert (found.lost, found.foreign) == (1, 1)


def test_missing_segment_is_reported(tmp_path: Path) -> None:
    account(tmp_path, MESSAGES)
    log = SegmentLog(tmp_path / "experience", segment_bytes=2**20, fsync="never", reserve_bytes=0)
    log.continue_from(3, CHUNKS + 5, [])
    log.append(Kind.CHUNK, MESSAGES[0])
    log.close()
    assert any("comes where 6 should" in problem for problem in read_log(tmp_path / "experience").problems)


@pytest.fixture
def window(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[RecordingWindow]:
    """An uploader's window that records to `a.txt`."""
    descriptor = os.open(tmp_path / "a.txt", os.O_WRONLY | os.O_CREAT)
    monkeypatch.setattr(RecordingWindow, "descriptor", descriptor)
    yield RecordingWindow()
    os.close(descriptor)


@pytest.mark.parametrize("reason", ["finished", "closed"])
def test_chunk_that_is_given_up_before_it_is_encoded_is_accounted_for(
    tmp_path: Path, window: RecordingWindow, reason: Reason
) -> None:
    for message in MESSAGES[:4]:
        window.put(window.reserve(), message)
    for _ in range(3):
        assert window.take() is not None
    window.acknowledge(2)
    window.reserve()
    window.leave_out(2)
    window.give_up_all(reason)
    window.give_up_all("closed")
    evidence = Evidence(tmp_path)
    evidence.read()
    assert evidence.counters["a", 7]["given_up"] == 5
    assert actors_imbalances(evidence) == []


def test_chunk_that_an_actor_did_not_record_is_an_imbalance(tmp_path: Path, window: RecordingWindow) -> None:
    window.put(window.reserve(), MESSAGES[0])
    UploadWindow.put(window, window.reserve(), MESSAGES[1])
    UploadWindow.give_up_all(window, "closed")
    window.give_up_all("closed")
    evidence = Evidence(tmp_path)
    evidence.read()
    (imbalance,) = actors_imbalances(evidence)
    assert "recorded {'produced': 1" in imbalance


def test_stall_counts_only_while_all_is_well() -> None:
    fault = Fault(FaultKind.LEARNER_KILLED, "learner", 1.0, 0)
    waited_for = Outage(Group((fault,), 1.0, recovers_first=True), 10.0, 14.0, recovered=20.0)
    not_waited_for = Outage(Group((fault,), 1.0, recovers_first=False), 30.0, 34.0)
    last = Outage(Group((fault,), 1.0, recovers_first=True), 35.0, 36.0, recovered=50.0)
    moments = [1.0, 4.0, 9.0, 20.0, 22.0, 28.0, 50.0, 51.0]
    assert longest_stall(moments, [waited_for, not_waited_for, last], 0.0, 53.0) == 6.0
    assert longest_stall([], [], 0.0, 53.0) == 53.0


@pytest.fixture
def linked() -> Iterator[tuple[Link, socket.socket, socket.socket]]:
    """A link with the service's end and the learner's end of one connection through it."""
    with ExitStack() as stack:
        learner = stack.enter_context(socket.create_server((HOST, 0)))
        proxies = stack.enter_context(LinkProxies({"a": learner.getsockname()[1]}))
        link = proxies.links["a"]
        service = stack.enter_context(socket.create_connection((HOST, link.port), timeout=20.0))
        accepted = stack.enter_context(learner.accept()[0])
        accepted.settimeout(20.0)
        yield link, service, accepted


def silent(end: socket.socket) -> bool:
    """Whether nothing arrives for a while."""
    end.settimeout(WAIT)
    try:
        end.recv(10)
    except TimeoutError:
        return True
    finally:
        end.settimeout(20.0)
    return False


def test_silent_link_lets_nothing_through_and_loses_nothing(linked) -> None:
    link, service, learner = linked
    link.silence(outward=True, inward=False)
    threading.Event().wait(WAIT)
    service.sendall(b"out")
    assert silent(learner)
    learner.sendall(b"in")
    assert service.recv(10) == b"in"
    link.heal()
    assert learner.recv(10) == b"out"


def test_cut_link_ends_connections_and_refuses_new_ones(linked) -> None:
    link, service, _ = linked
    link.cut()
    with pytest.raises(ConnectionResetError):
        service.recv(10)
    with socket.create_connection((HOST, link.port), timeout=20.0) as again, contextlib.suppress(OSError):
        assert again.recv(10) == b""


def test_flood_is_made_of_what_has_to_be_refused() -> None:
    messages = list(itertools.islice(malformed_messages("flood-1", random.Random(3)), 300))
    assert sum(message.settles for message in messages) == 20
    assert len({message.sender for message in messages}) == 21
    for message in messages:
        if message.settles:
            assert decode_chunk(message.payload).actor == message.sender
        else:
            with pytest.raises(InvalidMessage):
                decode_chunk(message.payload)
