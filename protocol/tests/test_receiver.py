"""A receiver that writes chunks down: nothing is acknowledged before it is safe, or after it cannot be."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest
import zenoh
from athrl_protocol import Chunk, ChunkIntake, ChunkUploader, InvalidMessage, new_incarnation
from athrl_protocol.codec.chunks import decode_chunk
from athrl_protocol.delivery.ledger import Ledger
from hypothesis import given
from hypothesis import strategies as some

PATIENCE = 30.0
RUN = "receiver"
Open = Callable[[], zenoh.Session]
Make = Callable[..., Chunk]


class _Paper:
    """Writes down what it is given; the ink dries when it is committed."""

    def __init__(self) -> None:
        self.wet: list[bytes] = []
        self.dry: list[bytes] = []
        self.refused: list[int] = []
        self.unfit: set[int] = set()
        self.broken: Exception | None = None
        self.may_dry = threading.Event()
        self.may_dry.set()

    def accept(self, chunk: Chunk, message: bytes) -> None:
        if chunk.sequence in self.unfit:
            raise InvalidMessage("value", "does not fit")
        self.wet.append(message)

    def refuse(self, chunk: Chunk) -> None:
        self.refused.append(chunk.sequence)

    def commit(self) -> None:
        assert self.may_dry.wait(PATIENCE)
        if self.broken is not None:
            raise self.broken
        self.dry += self.wet
        self.wet.clear()


@pytest.fixture
def paper() -> _Paper:
    return _Paper()


@pytest.fixture
def intake(listen: Open, paper: _Paper) -> Iterator[ChunkIntake]:
    with ChunkIntake(listen(), RUN, paper) as opened:
        yield opened


@pytest.fixture
def uploader(intake: ChunkIntake, connect: Open) -> Iterator[ChunkUploader]:
    with ChunkUploader(connect(), RUN, "actor-0", new_incarnation(), capacity=16) as opened:
        yield opened


def test_the_message_is_handed_over_as_it_came(
    uploader: ChunkUploader, make_chunk: Make, paper: _Paper
) -> None:
    for mark in range(5):
        assert uploader.submit(make_chunk(mark), PATIENCE)
    assert uploader.flush(PATIENCE)
    assert [decode_chunk(message).sequence for message in paper.dry] == list(range(5))


def test_nothing_is_acknowledged_before_it_is_committed(
    uploader: ChunkUploader, make_chunk: Make, paper: _Paper, eventually: Callable[..., None]
) -> None:
    paper.may_dry.clear()
    assert uploader.submit(make_chunk(), PATIENCE)
    eventually(lambda: len(paper.wet) == 1)
    assert uploader.statistics().acknowledged == 0
    paper.may_dry.set()
    assert uploader.flush(PATIENCE)
    assert len(paper.dry) == 1


def test_nothing_is_acknowledged_after_a_commit_failed(
    uploader: ChunkUploader,
    intake: ChunkIntake,
    make_chunk: Make,
    paper: _Paper,
    eventually: Callable[..., None],
) -> None:
    assert uploader.submit(make_chunk(), PATIENCE)
    assert uploader.flush(PATIENCE)
    paper.broken = OSError(5, "Input/output error")
    assert uploader.submit(make_chunk(), PATIENCE)
    # The chunk comes again and again, and its number is known by then: that is no reason to confirm it.
    eventually(lambda: intake.statistics().busy > 3)
    assert intake.failure is paper.broken
    assert uploader.statistics().acknowledged == 1


def test_a_refused_chunk_is_written_down_as_settled(
    uploader: ChunkUploader, intake: ChunkIntake, make_chunk: Make, paper: _Paper
) -> None:
    paper.unfit = {1}
    for mark in range(3):
        assert uploader.submit(make_chunk(mark), PATIENCE)
    assert uploader.flush(PATIENCE)
    assert paper.refused == [1]
    assert intake.totals() == {"stored": 2, "transitions": 8, "refused": 1, "lost": 0}


@given(
    some.lists(
        some.tuples(some.sampled_from("ab"), some.integers(0, 1), some.booleans(), some.integers(0, 3))
    )
)
def test_totals_are_all_chunks_that_are_settled(
    steps: list[tuple[str, int, bool, int]],
) -> None:
    ledger = Ledger()
    for actor, incarnation, fits, skipped in steps:
        sequence = ledger.next_sequence(actor, incarnation) + skipped
        if fits:
            ledger.record(_Numbers(actor, incarnation, sequence))  # type: ignore[arg-type]
        else:
            ledger.refuse(actor, incarnation, sequence)
    restored = Ledger(ledger.to_json(), ledger.totals_to_json())
    totals = restored.totals
    settled = sum(number for actor in restored.to_json().values() for number in actor.values())
    assert totals.stored + totals.refused + totals.lost == settled
    assert totals.lost == sum(skipped for *_, skipped in steps)


class _Numbers:
    """The numbers of a chunk without its columns."""

    length = 1

    def __init__(self, actor: str, incarnation: int, sequence: int) -> None:
        self.actor, self.incarnation, self.sequence = actor, incarnation, sequence
