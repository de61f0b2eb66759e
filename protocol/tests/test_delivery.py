"""Upload and intake over real sessions: every chunk once, whatever happens to either end."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh
from athrl_protocol import (
    Chunk,
    ChunkIntake,
    ChunkUploader,
    IntakeBusy,
    IntakeFinished,
    InvalidMessage,
    new_incarnation,
    open_session,
)

PATIENCE = 30.0
RUN = "delivery"
Open = Callable[[], zenoh.Session]
Make = Callable[..., Chunk]


def _mark(chunk: Chunk) -> int:
    return int(chunk.levels["intention"].rewards[0])


class _Store:
    """Keeps the marks of accepted chunks; `refuse` is raised instead if set."""

    def __init__(self) -> None:
        self.marks: list[int] = []
        self.refuse: Exception | None = None

    def __call__(self, chunk: Chunk) -> None:
        if self.refuse is not None:
            raise self.refuse
        self.marks.append(_mark(chunk))


@pytest.fixture
def store() -> _Store:
    return _Store()


@pytest.fixture
def uploader(connect: Open, listen: Open) -> Iterator[ChunkUploader]:
    """An uploader whose learner may come and go; its session was opened while a learner listened."""
    first = listen()
    session = connect()
    first.close()
    with ChunkUploader(session, RUN, "actor-0", new_incarnation(), capacity=8) as opened:
        yield opened


def _submit(uploader: ChunkUploader, make_chunk: Make, marks: range) -> None:
    for mark in marks:
        assert uploader.submit(make_chunk(mark), PATIENCE)


def test_chunks_arrive_in_order_and_whole(uploader: ChunkUploader, listen: Open, make_chunk: Make) -> None:
    taken: list[Chunk] = []
    with ChunkIntake(listen(), RUN, taken.append) as intake:
        _submit(uploader, make_chunk, range(50))
        assert uploader.flush(PATIENCE)
        assert intake.statistics().transitions == 200
    assert [_mark(chunk) for chunk in taken] == list(range(50))
    assert [chunk.sequence for chunk in taken] == list(range(50))
    assert (taken[7].images == make_chunk(7).images).all()
    counts = uploader.statistics()
    assert (counts.produced, counts.acknowledged, counts.waiting, counts.given_up) == (50, 50, 0, 0)


def test_uploader_goes_on_when_its_learner_returns(
    uploader: ChunkUploader, listen: Open, make_chunk: Make, store: _Store, eventually: Callable[..., None]
) -> None:
    ledger: dict[str, dict[str, int]] = {}
    for start in (0, 8, 16):
        session = listen()
        with ChunkIntake(session, RUN, store, ledger) as intake:
            assert uploader.flush(PATIENCE)
            ledger = intake.ledger()
        session.close()
        _submit(uploader, make_chunk, range(start, start + 8))  # while no learner listens
        assert not uploader.submit(make_chunk(99), 0.0), "the bound is reached"
        eventually(lambda: uploader.statistics().resent > 0)
    with ChunkIntake(listen(), RUN, store, ledger) as intake:
        assert uploader.flush(PATIENCE)
        assert intake.statistics().lost == 0
    assert store.marks == list(range(24))


def test_uploader_survives_kills_of_a_learner_in_another_process(
    address: str, connect: Open, make_chunk: Make, tmp_path: Path
) -> None:
    script = Path(__file__).with_name("learner_process.py")
    command = [sys.executable, str(script), address, RUN, str(tmp_path)]
    learner = subprocess.Popen(command)
    chunks = [make_chunk(mark) for mark in range(10)]
    try:
        with ChunkUploader(connect(), RUN, "actor-0", new_incarnation(), capacity=64) as uploader:
            for part in range(4):
                for mark in range(100 * part, 100 * part + 100):
                    assert uploader.submit(chunks[mark % 10], PATIENCE)
                if part < 3:
                    learner.kill()
                    learner.wait(PATIENCE)
                    learner = subprocess.Popen(command)
            assert uploader.flush(PATIENCE)
            assert uploader.statistics().acknowledged == 400
    finally:
        learner.kill()
        learner.wait(PATIENCE)
    lines = [line.split() for line in (tmp_path / "chunks.txt").read_text().splitlines()]
    assert [int(line[2]) for line in lines] == list(range(400))
    assert [int(line[3]) for line in lines] == [sequence % 10 for sequence in range(400)]


def test_restarted_actor_is_heard_at_once(
    connect: Open, listen: Open, make_chunk: Make, store: _Store
) -> None:
    with ChunkIntake(listen(), RUN, store) as intake:
        for start in (0, 20, 40):
            with ChunkUploader(connect(), RUN, "actor-0", new_incarnation(), capacity=8) as uploader:
                count = 10 if start == 0 else 3  # the later ones never overtake the first one's numbers
                _submit(uploader, make_chunk, range(start, start + count))
                assert uploader.flush(PATIENCE)
        assert intake.statistics().duplicates == 0
        assert intake.statistics().active_actors == 1
        assert len(intake.ledger()["actor-0"]) == 3
    assert store.marks == [*range(10), 20, 21, 22, 40, 41, 42]


def test_replaced_actor_is_heard_at_once_while_the_former_one_still_sends(
    connect: Open, listen: Open, make_chunk: Make, store: _Store
) -> None:
    with ChunkIntake(listen(), RUN, store) as intake:
        with ChunkUploader(connect(), RUN, "actor-0", new_incarnation(), capacity=8) as former:
            _submit(former, make_chunk, range(10))
            assert former.flush(PATIENCE)
            with ChunkUploader(connect(), RUN, "actor-0", new_incarnation(), capacity=8) as new:
                for mark in range(20, 25):
                    _submit(new, make_chunk, range(mark, mark + 1))
                    _submit(former, make_chunk, range(mark + 20, mark + 21))
                assert new.flush(PATIENCE)
                assert former.flush(PATIENCE)
                assert new.statistics().resent == former.statistics().resent == 0
        assert intake.statistics().duplicates == intake.statistics().gaps == intake.statistics().lost == 0
        assert sorted(intake.ledger()["actor-0"].values()) == [5, 15]
    assert [mark for mark in store.marks if 20 <= mark < 40] == [20, 21, 22, 23, 24]
    assert [mark for mark in store.marks if not 20 <= mark < 40] == [*range(10), 40, 41, 42, 43, 44]


def test_gap_is_asked_for_again_and_every_chunk_is_stored_once_in_order(
    uploader: ChunkUploader,
    listen: Open,
    make_chunk: Make,
    eventually: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("athrl_protocol.delivery.upload_pace.MOST_CHUNKS", 1)
    marks: list[int] = []
    all_submitted, several_under_way, sent_back = (threading.Event() for _ in range(3))

    def accept(chunk: Chunk) -> None:
        assert _mark(chunk) == 0 or all_submitted.wait(PATIENCE)
        if _mark(chunk) == 2 and not sent_back.is_set():
            assert several_under_way.wait(PATIENCE)
            sent_back.set()
            raise IntakeBusy  # those that follow it are on their way already
        marks.append(_mark(chunk))

    with ChunkIntake(listen(), RUN, accept) as intake:
        _submit(uploader, make_chunk, range(1))
        assert uploader.flush(PATIENCE)  # it has credits now
        _submit(uploader, make_chunk, range(1, 8))
        all_submitted.set()
        eventually(lambda: len(uploader._in_flight) >= 3)
        several_under_way.set()
        assert uploader.flush(PATIENCE)
        assert intake.statistics().gaps >= 1
        assert intake.statistics().lost == 0
    assert marks == list(range(8))
    assert uploader.statistics().turned_away >= 2


def test_acknowledged_only_after_it_was_accepted(
    uploader: ChunkUploader, listen: Open, make_chunk: Make, eventually: Callable[..., None]
) -> None:
    entered, leave = threading.Event(), threading.Event()

    def accept(_: Chunk) -> None:
        entered.set()
        assert leave.wait(PATIENCE)

    with ChunkIntake(listen(), RUN, accept):
        _submit(uploader, make_chunk, range(1))
        assert entered.wait(PATIENCE)
        assert uploader.statistics().acknowledged == 0
        leave.set()
        assert uploader.flush(PATIENCE)
    assert uploader.statistics().acknowledged == 1


def test_busy_learner_gets_the_chunks_later_once_each(
    uploader: ChunkUploader, listen: Open, make_chunk: Make, store: _Store, eventually: Callable[..., None]
) -> None:
    store.refuse = IntakeBusy()
    _submit(uploader, make_chunk, range(8))  # before a learner answers: for a busy one fewer may be held
    with ChunkIntake(listen(), RUN, store) as intake:
        eventually(lambda: intake.statistics().busy >= 3)
        assert uploader.statistics().acknowledged == 0
        store.refuse = None
        assert uploader.flush(PATIENCE)
    assert store.marks == list(range(8))


@pytest.mark.parametrize("raised", [True, False], ids=["by accept", "by stop_accepting"])
def test_uploader_stops_when_the_run_is_over(
    uploader: ChunkUploader,
    listen: Open,
    make_chunk: Make,
    store: _Store,
    eventually: Callable[..., None],
    raised: bool,
) -> None:
    with ChunkIntake(listen(), RUN, store) as intake:
        if raised:
            store.refuse = IntakeFinished()
        else:
            intake.stop_accepting(finished=True)
        assert uploader.submit(make_chunk(0), PATIENCE)
        eventually(lambda: uploader.finished)
        assert not uploader.submit(make_chunk(1), PATIENCE)
        assert uploader.statistics().given_up_by_reason["finished"] == 1


def test_drained_learner_leaves_chunks_with_their_actor_for_the_next(
    uploader: ChunkUploader, listen: Open, make_chunk: Make, store: _Store, eventually: Callable[..., None]
) -> None:
    session = listen()
    with ChunkIntake(session, RUN, store) as intake:
        _submit(uploader, make_chunk, range(3))
        assert uploader.flush(PATIENCE)
        intake.stop_accepting()
        ledger = intake.ledger()
        _submit(uploader, make_chunk, range(3, 6))
        eventually(lambda: intake.statistics().busy > 0)
    session.close()
    assert store.marks == [0, 1, 2]
    with ChunkIntake(listen(), RUN, store, ledger):
        assert uploader.flush(PATIENCE)
    assert store.marks == list(range(6))


def test_chunk_that_does_not_fit_the_run_is_given_up_and_the_next_is_taken(
    uploader: ChunkUploader, listen: Open, make_chunk: Make
) -> None:
    marks: list[int] = []

    def accept(chunk: Chunk) -> None:
        if _mark(chunk) == 2:
            raise InvalidMessage("shape", "chunk: images are 8 pixels wide, this run has 32")
        marks.append(_mark(chunk))

    with ChunkIntake(listen(), RUN, accept) as intake:
        _submit(uploader, make_chunk, range(5))
        assert uploader.flush(PATIENCE)
        assert intake.statistics().invalid == {"shape": 1}
        assert intake.statistics().lost == 0
    assert marks == [0, 1, 3, 4]
    assert (uploader.statistics().acknowledged, uploader.statistics().given_up) == (4, 1)
    assert uploader.statistics().given_up_by_reason["invalid"] == 1


def test_chunk_that_is_not_valid_is_given_up_and_those_around_it_arrive(
    uploader: ChunkUploader, listen: Open, make_chunk: Make, store: _Store, caplog: pytest.LogCaptureFixture
) -> None:
    broken = make_chunk(1)
    broken.motion[0] = np.nan
    with ChunkIntake(listen(), RUN, store) as intake:
        for chunk in (make_chunk(0), broken, make_chunk(2)):
            assert uploader.submit(chunk, PATIENCE)
        assert uploader.flush(PATIENCE)
        assert intake.statistics().invalid == {}
        assert intake.statistics().lost == 1  # it never saw that one
    assert store.marks == [0, 2]
    assert (uploader.statistics().produced, uploader.statistics().acknowledged) == (3, 2)
    assert uploader.statistics().given_up_by_reason["invalid"] == 1
    assert "chunk 1 is given up: chunk: motion has numbers that are not finite" in caplog.text


def test_learner_from_an_older_checkpoint_takes_the_jump_and_counts_what_is_lost(
    uploader: ChunkUploader, listen: Open, make_chunk: Make, store: _Store
) -> None:
    session = listen()
    with ChunkIntake(session, RUN, store) as intake:
        _submit(uploader, make_chunk, range(4))
        assert uploader.flush(PATIENCE)
        checkpoint = intake.ledger()
        _submit(uploader, make_chunk, range(4, 10))
        assert uploader.flush(PATIENCE)
    session.close()
    _submit(uploader, make_chunk, range(10, 15))
    restored = _Store()
    with ChunkIntake(listen(), RUN, restored, checkpoint) as intake:
        assert uploader.flush(PATIENCE)
        assert intake.statistics().lost == 6
    assert restored.marks == list(range(10, 15))


def test_failure_of_the_learner_itself_is_kept_and_nothing_is_acknowledged(
    uploader: ChunkUploader, listen: Open, make_chunk: Make, store: _Store, eventually: Callable[..., None]
) -> None:
    store.refuse = OSError("disk full")
    with ChunkIntake(listen(), RUN, store) as intake:
        _submit(uploader, make_chunk, range(2))
        eventually(lambda: intake.failure is not None)
        eventually(lambda: intake.statistics().busy > 1)
    assert uploader.statistics().acknowledged == 0
    assert uploader.statistics().waiting == 2


def test_paused_intake_takes_nothing_in(
    uploader: ChunkUploader, listen: Open, make_chunk: Make, store: _Store
) -> None:
    with ChunkIntake(listen(), RUN, store) as intake:
        _submit(uploader, make_chunk, range(2))
        assert uploader.flush(PATIENCE)
        with intake.paused():
            _submit(uploader, make_chunk, range(2, 4))
            assert not uploader.flush(0.05)
            assert store.marks == [0, 1]
            assert list(intake.ledger()["actor-0"].values()) == [2]
        assert uploader.flush(PATIENCE)
    assert store.marks == [0, 1, 2, 3]


def test_several_actors_are_taken_in_side_by_side(connect: Open, listen: Open, make_chunk: Make) -> None:
    taken: list[Chunk] = []
    with ChunkIntake(listen(), RUN, taken.append) as intake:
        uploaders = [
            ChunkUploader(connect(), RUN, f"actor-{number}", new_incarnation(), capacity=8)
            for number in range(4)
        ]
        try:
            for mark in range(20):
                for uploader in uploaders:
                    assert uploader.submit(make_chunk(mark), PATIENCE)
            assert all(uploader.flush(PATIENCE) for uploader in uploaders)
        finally:
            for uploader in uploaders:
                uploader.close()
        assert intake.statistics().chunks == 80
        assert intake.statistics().active_actors == 4
    for number in range(4):
        assert [_mark(chunk) for chunk in taken if chunk.actor == f"actor-{number}"] == list(range(20))


def test_closing_wakes_whoever_waits(address: str, listen: Open, connect: Open, make_chunk: Make) -> None:
    listen()
    uploader = ChunkUploader(connect(), RUN, "actor-0", new_incarnation(), capacity=1)
    assert uploader.submit(make_chunk(0), PATIENCE)
    results: list[bool] = []
    waiters = [
        threading.Thread(target=lambda: results.append(uploader.submit(make_chunk(1), PATIENCE))),
        threading.Thread(target=lambda: results.append(uploader.flush(PATIENCE))),
    ]
    for waiter in waiters:
        waiter.start()
    uploader.close()
    for waiter in waiters:
        waiter.join(PATIENCE)
    assert results == [False, False]
    counts = uploader.statistics()
    assert (counts.waiting, counts.given_up) == (0, 1)


def test_process_ends_although_nothing_was_closed_but_the_session(address: str, make_chunk: Make) -> None:
    with open_session(listen=address, timeout=PATIENCE) as session:
        intake = ChunkIntake(session, RUN, lambda _: None)
        uploader = ChunkUploader(session, RUN, "actor-0", new_incarnation(), capacity=4)
        assert uploader.submit(make_chunk(0), PATIENCE)
        assert uploader.flush(PATIENCE)
    assert uploader.submit(make_chunk(1), PATIENCE)
    uploader.close()
    intake.close()
    assert uploader.statistics().given_up_by_reason["closed"] == 1
