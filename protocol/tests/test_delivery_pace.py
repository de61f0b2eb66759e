"""Who waits for whom while chunks are delivered: actor, learner, disk."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest
import zenoh
from athrl_protocol import Chunk, ChunkIntake, ChunkUploader, IntakeBusy, new_incarnation
from athrl_protocol.delivery import upload as upload_module
from athrl_protocol.delivery.credits import CREDITS
from athrl_protocol.delivery.upload_pace import HELD_WHILE_BUSY

PATIENCE = 30.0
RUN = "pace"
Open = Callable[[], zenoh.Session]
Make = Callable[..., Chunk]


def _submit(uploader: ChunkUploader, make_chunk: Make, marks: range) -> None:
    for mark in marks:
        assert uploader.submit(make_chunk(mark), PATIENCE)


class _Receiver:
    """Keeps the marks of accepted chunks; raises `raises` instead if set. Its commits take `seconds`."""

    def __init__(self) -> None:
        self.marks: list[int] = []
        self.raises: Exception | None = None
        self.may_accept = threading.Event()
        self.may_accept.set()
        self.seconds = 0.0
        self.commits = 0

    def accept(self, chunk: Chunk, message: bytes) -> None:
        assert self.may_accept.wait(PATIENCE)
        if self.raises is not None:
            raise self.raises
        self.marks.append(int(chunk.levels["intention"].rewards[0]))

    def refuse(self, chunk: Chunk) -> None:
        raise AssertionError("no chunk here is invalid")

    def commit(self) -> None:
        self.commits += 1
        time.sleep(self.seconds)


def test_actor_runs_ahead_of_an_absent_learner_but_not_of_a_busy_one(
    connect: Open, listen: Open, make_chunk: Make, eventually: Callable[..., None]
) -> None:
    session, receiver = listen(), _Receiver()
    with ChunkUploader(connect(), RUN, "actor-0", new_incarnation(), capacity=40) as uploader:
        with ChunkIntake(session, RUN, receiver) as intake:
            _submit(uploader, make_chunk, range(1))
            assert uploader.flush(PATIENCE)
            turned_away = uploader.statistics().turned_away
            receiver.raises = IntakeBusy()
            _submit(uploader, make_chunk, range(1, 2))
            eventually(lambda: uploader.statistics().turned_away > turned_away)  # it was told
            held = 1
            while uploader.submit(make_chunk(1 + held), 0.2):
                held += 1
            # what is held while the learner is busy is of an old policy when it arrives
            assert held == HELD_WHILE_BUSY
            assert receiver.marks == [0]
        session.close()
        _submit(uploader, make_chunk, range(1 + held, 41))  # now there is no answer
        receiver.raises = None
        with ChunkIntake(listen(), RUN, receiver, intake.ledger()):
            assert uploader.flush(PATIENCE)
    assert receiver.marks == list(range(41))


def test_actor_goes_on_making_chunks_while_the_learner_is_at_work(
    connect: Open, listen: Open, make_chunk: Make
) -> None:
    receiver = _Receiver()
    with (
        ChunkIntake(listen(), RUN, receiver),
        ChunkUploader(connect(), RUN, "actor-0", new_incarnation(), capacity=1000) as uploader,
    ):
        _submit(uploader, make_chunk, range(1))
        assert uploader.flush(PATIENCE)
        receiver.may_accept.clear()
        _submit(uploader, make_chunk, range(1, 1 + 2 * CREDITS))  # as many ready as are under way
        assert not uploader.submit(make_chunk(1), 0.0)
        receiver.may_accept.set()
        assert uploader.flush(PATIENCE)
    assert receiver.marks == list(range(1 + 2 * CREDITS))


def test_busy_learner_is_asked_with_one_chunk_at_a_time(
    connect: Open, listen: Open, make_chunk: Make, eventually: Callable[..., None]
) -> None:
    receiver = _Receiver()
    with (
        ChunkIntake(listen(), RUN, receiver) as intake,
        ChunkUploader(connect(), RUN, "actor-0", new_incarnation(), capacity=100) as uploader,
    ):
        _submit(uploader, make_chunk, range(1))
        assert uploader.flush(PATIENCE)
        receiver.raises = IntakeBusy()
        _submit(uploader, make_chunk, range(1, 1 + HELD_WHILE_BUSY))
        eventually(lambda: intake.statistics().busy > 20)
        # The first time all were in flight. From then on the others would only get a gap as the answer.
        assert intake.statistics().gaps < HELD_WHILE_BUSY
        receiver.raises = None
        assert uploader.flush(PATIENCE)


def test_slow_disk_is_asked_once_for_many_chunks(connect: Open, listen: Open, make_chunk: Make) -> None:
    receiver = _Receiver()
    with (
        ChunkIntake(listen(), RUN, receiver),
        ChunkUploader(connect(), RUN, "actor-0", new_incarnation(), capacity=100) as uploader,
    ):
        receiver.seconds = 0.2
        _submit(uploader, make_chunk, range(40))
        assert uploader.flush(PATIENCE)
        assert receiver.commits < 40
        assert uploader.statistics().acknowledged == len(receiver.marks) == 40


def test_uploader_rests_once_the_run_is_over(
    connect: Open,
    listen: Open,
    make_chunk: Make,
    eventually: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rounds, send = [], ChunkUploader._send_allowed
    monkeypatch.setattr(ChunkUploader, "_send_allowed", lambda self: (rounds.append(1), send(self))[1])
    session, receiver = listen(), _Receiver()
    with (
        ChunkUploader(connect(), RUN, "actor-0", new_incarnation(), capacity=40) as uploader,
        ChunkIntake(session, RUN, receiver) as intake,
    ):
        _submit(uploader, make_chunk, range(1))
        assert uploader.flush(PATIENCE)
        turned_away = uploader.statistics().turned_away
        receiver.raises = IntakeBusy()
        _submit(uploader, make_chunk, range(1, HELD_WHILE_BUSY))
        eventually(lambda: uploader.statistics().turned_away > turned_away)  # it was told
        _submit(uploader, make_chunk, range(HELD_WHILE_BUSY, HELD_WHILE_BUSY + 1))
        intake.stop_accepting(finished=True)
        eventually(lambda: uploader.finished)
        rounds.clear()
        time.sleep(10 * upload_module.GATHER_SECONDS)
        assert len(rounds) < 10


def test_lone_chunk_is_sent_although_no_other_follows(
    connect: Open,
    listen: Open,
    make_chunk: Make,
    eventually: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(upload_module, "IDLE_SECONDS", 4 * PATIENCE)
    session, receiver = listen(), _Receiver()
    with (
        ChunkUploader(connect(), RUN, "actor-0", new_incarnation(), capacity=40) as uploader,
        ChunkIntake(session, RUN, receiver),
    ):
        for mark in range(3):
            _submit(uploader, make_chunk, range(mark, mark + 1))
            eventually(lambda awaited=mark: uploader.statistics().acknowledged > awaited)
