"""What the intake answers to a query that an uploader of ours would not send just so."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import pytest
import zenoh
from athrl_protocol import Chunk, ChunkIntake, Keys, encode_chunk
from athrl_protocol.messages import athrl_pb2

PATIENCE = 30.0
RUN = "answers"
Open = Callable[[], zenoh.Session]
Make = Callable[..., Chunk]


class _Marks:
    """Takes every chunk and keeps its first reward."""

    def __init__(self) -> None:
        self.taken: list[int] = []

    def __call__(self, chunk: Chunk) -> None:
        self.taken.append(int(chunk.levels["intention"].rewards[0]))


@pytest.fixture
def marks() -> _Marks:
    return _Marks()


def _ask(session: zenoh.Session, actor: str, payload: bytes) -> athrl_pb2.Refusal | athrl_pb2.Acknowledgement:
    for reply in session.get(Keys(RUN).experience(actor), payload=payload, timeout=PATIENCE):
        if reply.ok is not None:
            return athrl_pb2.Acknowledgement.FromString(reply.ok.payload.to_bytes())
        assert reply.err is not None
        return athrl_pb2.Refusal.FromString(reply.err.payload.to_bytes())
    raise AssertionError("no answer")


def _chunk(make_chunk: Make, sequence: int, actor: str = "actor-0") -> bytes:
    return encode_chunk(
        dataclasses.replace(make_chunk(sequence), actor=actor, incarnation=7, sequence=sequence)
    )


def test_duplicate_is_acknowledged_again_and_not_counted_again(
    connect: Open, listen: Open, make_chunk: Make, marks: _Marks
) -> None:
    with ChunkIntake(listen(), RUN, marks) as intake:
        session = connect()
        for sequence in (0, 0, 1, 0, 1):
            answer = _ask(session, "actor-0", _chunk(make_chunk, sequence))
            assert isinstance(answer, athrl_pb2.Acknowledgement)
            assert answer.credits >= 1
        assert answer.next_sequence == 2
        assert intake.statistics().duplicates == 3
        assert intake.statistics().transitions == 8
    assert marks.taken == [0, 1]


def test_gap_is_answered_with_what_is_expected(
    connect: Open, listen: Open, make_chunk: Make, marks: _Marks
) -> None:
    with ChunkIntake(listen(), RUN, marks) as intake:
        answer = _ask(connect(), "actor-0", _chunk(make_chunk, 5))
        assert isinstance(answer, athrl_pb2.Refusal)
        assert (answer.reason, answer.expected_sequence) == (athrl_pb2.Refusal.EXPECTED, 0)
        assert intake.statistics().gaps == 1
    assert marks.taken == []


def test_forged_incarnations_leave_the_living_one_in_place(
    connect: Open, listen: Open, make_chunk: Make, marks: _Marks, caplog: pytest.LogCaptureFixture
) -> None:
    """Its chunks are neither lost nor taken in twice, and the forger is told and logged by name."""
    honest = [_chunk(make_chunk, sequence) for sequence in range(3)]
    with ChunkIntake(listen(), RUN, marks) as intake:
        session = connect()
        _ask(session, "actor-0", honest[0])
        for number in range(70):
            forged = athrl_pb2.Chunk.FromString(honest[0])
            forged.incarnation = 2**64 - 1 - number
            answer = _ask(session, "actor-0", forged.SerializeToString())
            assert isinstance(answer, athrl_pb2.Refusal)
            assert f"incarnation {forged.incarnation} begins at" in answer.text
        for message in (honest[1], honest[0], honest[2], honest[1]):
            assert isinstance(_ask(session, "actor-0", message), athrl_pb2.Acknowledgement)
        statistics = intake.statistics()
        assert (statistics.stored, statistics.duplicates, statistics.lost) == (3, 2, 0)
        assert statistics.invalid == {"incarnation": 70}
    assert marks.taken == [0, 1, 2]
    assert any("a chunk of actor-0 was refused (incarnation)" in text for text in caplog.messages)


def test_lost_chunks_are_one_line_of_warning(
    connect: Open, listen: Open, make_chunk: Make, marks: _Marks, caplog: pytest.LogCaptureFixture
) -> None:
    with ChunkIntake(listen(), RUN, marks) as intake:
        session = connect()
        for sequence in (3, 9):
            chunk = athrl_pb2.Chunk.FromString(_chunk(make_chunk, sequence))
            chunk.oldest_held = sequence
            assert isinstance(_ask(session, "actor-0", chunk.SerializeToString()), athrl_pb2.Acknowledgement)
        assert intake.statistics().lost == 8
    assert [text for text in caplog.messages if "lost" in text] == [
        "chunks of actor-0 are lost (intake/lost): it does not hold them any more, and they were not "
        "accepted here; another process may have acknowledged them"
    ]


def test_rubbish_is_refused_by_reason_and_does_no_harm(
    connect: Open, listen: Open, make_chunk: Make, marks: _Marks
) -> None:
    good = _chunk(make_chunk, 0)
    other_schema = athrl_pb2.Chunk.FromString(good)
    other_schema.schema_hash += 1
    with ChunkIntake(listen(), RUN, marks) as intake:
        session = connect()
        for payload in (b"", b"rubbish", other_schema.SerializeToString(), _chunk(make_chunk, 0, actor="b")):
            answer = _ask(session, "actor-0", payload)
            assert isinstance(answer, athrl_pb2.Refusal)
            assert answer.reason == athrl_pb2.Refusal.INVALID
            assert answer.text
        assert isinstance(_ask(session, "actor-0", good), athrl_pb2.Acknowledgement)
        assert intake.statistics().invalid == {"schema": 2, "malformed": 1, "value": 1}
    assert marks.taken == [0]
