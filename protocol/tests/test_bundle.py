"""Several chunks in one query: each is settled separately, and chunks after a refused one are not lost."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import pytest
import zenoh
from athrl_protocol import (
    Chunk,
    ChunkIntake,
    ChunkUploader,
    IntakeBusy,
    IntakeFinished,
    InvalidMessage,
    Keys,
    encode_chunk,
    new_incarnation,
)
from athrl_protocol.delivery.bundle import MOST_BYTES, MOST_CHUNKS, join_messages, split_messages
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.schema import decode_message, encode_message
from hypothesis import given
from hypothesis import strategies as some

PATIENCE = 30.0
RUN = "together"
Open = Callable[[], zenoh.Session]
Make = Callable[..., Chunk]


class Learner:
    """Keeps the marks of chunks; refuses those of `refuse` once each, with what stands there."""

    def __init__(self) -> None:
        self.marks: list[int] = []
        self.refuse: dict[int, Exception] = {}

    def __call__(self, chunk: Chunk) -> None:
        mark = int(chunk.levels["intention"].rewards[0])
        if mark in self.refuse:
            raise self.refuse.pop(mark)
        self.marks.append(mark)


@pytest.fixture
def learner() -> Learner:
    return Learner()


@pytest.fixture
def queries(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many chunks each query brought, as the intake saw it."""
    counts: list[int] = []

    def watched(content: bytes, attachment: bytes | None) -> list[bytes]:
        messages = split_messages(content, attachment)
        counts.append(len(messages))
        return messages

    monkeypatch.setattr("athrl_protocol.delivery.intake.split_messages", watched)
    return counts


@pytest.fixture
def send(listen: Open, connect: Open, learner: Learner, make_chunk: Make) -> Callable[..., ChunkUploader]:
    """Sends chunks 1 to `count` together, after chunk 0, which earns credits, until all is settled."""

    def send(count: int, **chunk: int) -> tuple[ChunkUploader, ChunkIntake]:
        with (
            ChunkIntake(listen(), RUN, learner) as intake,
            ChunkUploader(connect(), RUN, "a", new_incarnation(), capacity=64) as uploader,
        ):
            assert uploader.submit(make_chunk(0), PATIENCE)
            assert uploader.flush(PATIENCE)
            for mark in range(1, count + 1):
                assert uploader.submit(make_chunk(mark, **chunk), PATIENCE)
            assert uploader.flush(PATIENCE)
        return uploader, intake

    return send


def test_what_comes_within_a_moment_goes_together_and_in_order(send, learner, queries) -> None:
    uploader, _ = send(48)
    assert learner.marks == list(range(49))
    assert uploader.statistics().acknowledged == 49
    assert uploader.statistics().resent == 0
    assert sum(queries) == 49
    assert max(queries) == MOST_CHUNKS
    assert len(queries) <= 1 + 8  # the first one alone


def test_chunk_that_nobody_waits_for_goes_after_a_moment(
    listen: Open, connect: Open, learner: Learner, make_chunk: Make, eventually: Callable[..., None]
) -> None:
    with (
        ChunkIntake(listen(), RUN, learner),
        ChunkUploader(connect(), RUN, "a", new_incarnation(), capacity=64) as uploader,
    ):
        for mark in range(4):
            assert uploader.submit(make_chunk(mark), PATIENCE)
            eventually(lambda wanted=mark + 1: len(learner.marks) == wanted)


def test_busy_in_the_middle_keeps_what_was_taken_and_brings_the_rest_again(send, learner, queries) -> None:
    learner.refuse = {4: IntakeBusy(), 9: IntakeBusy()}
    uploader, intake = send(16)
    assert learner.marks == list(range(17))
    assert intake.statistics().duplicates == 0
    assert intake.statistics().busy == 2
    assert uploader.statistics().acknowledged == 17


def test_invalid_chunk_in_the_middle_is_given_up_alone(send, learner, queries, caplog) -> None:
    learner.refuse = {
        4: InvalidMessage("value", "not\nfor\x1b[2J this run"),
        16: InvalidMessage("value", "neither"),
    }
    uploader, intake = send(16)
    assert learner.marks == [mark for mark in range(17) if mark not in (4, 16)]
    statistics = uploader.statistics()
    assert (statistics.acknowledged, statistics.given_up_by_reason["invalid"]) == (15, 2)
    refused = [message for message in caplog.messages if message.startswith("the learner refused chunk ")]
    assert [message.split()[4] for message in refused] == ["4:", "16:"]
    assert all(message.isprintable() for message in refused)
    assert (intake.statistics().stored, intake.statistics().refused) == (15, 2)
    assert intake.statistics().lost == 0


def test_end_of_the_run_in_the_middle_settles_all(listen, connect, learner, make_chunk) -> None:
    learner.refuse = {5: IntakeFinished()}
    with (
        ChunkIntake(listen(), RUN, learner),
        ChunkUploader(connect(), RUN, "a", new_incarnation(), capacity=64) as uploader,
    ):
        assert uploader.submit(make_chunk(0), PATIENCE)
        assert uploader.flush(PATIENCE)
        for mark in range(1, 9):
            uploader.submit(make_chunk(mark), PATIENCE)
        uploader.flush(PATIENCE)
        statistics = uploader.statistics()
        assert (statistics.acknowledged, statistics.given_up_by_reason["finished"]) == (5, 4)
        assert uploader.finished


def test_large_chunks_go_together_only_as_far_as_they_fit(send, learner, queries, monkeypatch) -> None:
    sizes: list[int] = []

    def watched(messages: list[bytes]) -> tuple[bytes, bytes | None]:
        content, attachment = join_messages(messages)
        sizes.append(len(content))
        return content, attachment

    monkeypatch.setattr("athrl_protocol.delivery.upload.join_messages", watched)
    send(12, time=1024)  # 300 KB each, as noise cannot be compressed
    assert learner.marks == list(range(13))
    assert max(queries) == 3
    assert max(sizes) <= MOST_BYTES


@given(some.lists(some.binary(max_size=40), min_size=1, max_size=MOST_CHUNKS))
def test_messages_come_apart_as_they_were_joined(messages: list[bytes]) -> None:
    assert split_messages(*join_messages(messages)) == messages


@pytest.mark.parametrize(
    ("attachment", "reason"),
    [
        (b"no message", "malformed"),
        (b"", "schema"),
        (athrl_pb2.Delivery(schema_version=99, sizes=[4]).SerializeToString(), "schema"),
        (encode_message(athrl_pb2.Delivery()), "shape"),
        (encode_message(athrl_pb2.Delivery(sizes=[3])), "shape"),
        (encode_message(athrl_pb2.Delivery(sizes=[5])), "shape"),
        (encode_message(athrl_pb2.Delivery(sizes=[2**32 - 1, 5])), "shape"),
        (encode_message(athrl_pb2.Delivery(sizes=[4] + [0] * MOST_CHUNKS)), "shape"),
        (encode_message(athrl_pb2.Delivery(sizes=[0] * 100_000)), "size"),
    ],
)
def test_attachment_that_does_not_fit_is_refused(attachment: bytes, reason: str) -> None:
    with pytest.raises(InvalidMessage) as caught:
        split_messages(b"four", attachment)
    assert caught.value.reason == reason


def test_strangers_delivery_is_refused_by_its_first_bad_chunk_and_the_ones_before_it_are_in(
    listen: Open, connect: Open, learner: Learner, make_chunk: Make
) -> None:
    def encoded(sequence: int) -> bytes:
        return encode_chunk(
            dataclasses.replace(make_chunk(sequence), actor="a", incarnation=1, sequence=sequence)
        )

    def answer(content: bytes, attachment: bytes | None) -> athrl_pb2.Refusal:
        began = time.monotonic()
        while time.monotonic() - began < PATIENCE:
            for reply in session.get(Keys(RUN).experience("a"), payload=content, attachment=attachment):
                if reply.err is not None and reply.err.payload.to_bytes() != b"Timeout":
                    return decode_message(athrl_pb2.Refusal, reply.err.payload.to_bytes())
        raise AssertionError("no answer")

    with ChunkIntake(listen(), RUN, learner, largest=10_000) as intake:
        session = connect()
        refusal = answer(*join_messages([encoded(0), encoded(1), b"noise", encoded(2)]))
        assert (refusal.reason, refusal.index) == (athrl_pb2.Refusal.INVALID, 2)
        assert learner.marks == [0, 1]
        refusal = answer(*join_messages([encoded(2), bytes(10_001)]))
        assert (refusal.index, refusal.text) == (1, "chunk: 10001 bytes, at most 10000 in this run")
        refusal = answer(*join_messages([bytes(MOST_BYTES), b""]))
        assert refusal.index == 0
        assert learner.marks == [0, 1, 2]
        assert intake.statistics().invalid_by_sender["a"]["size"] == 2
        session.close()


def test_answer_about_a_chunk_that_was_not_asked_about_settles_nothing(
    listen: Open, connect: Open, make_chunk: Make, eventually: Callable[..., None]
) -> None:
    session = listen()
    answers = [athrl_pb2.Refusal(reason=athrl_pb2.Refusal.INVALID, index=7)]

    def reply(query: zenoh.Query) -> None:
        with query:
            if answers:
                query.reply_err(encode_message(answers.pop()))
            else:
                query.reply(query.key_expr, encode_message(athrl_pb2.Acknowledgement(next_sequence=1)))

    queryable = session.declare_queryable(Keys(RUN).experience("a"), reply, complete=True)
    with ChunkUploader(connect(), RUN, "a", new_incarnation(), capacity=4) as uploader:
        assert uploader.submit(make_chunk(0), PATIENCE)
        assert uploader.flush(PATIENCE)
        assert uploader.statistics().acknowledged == 1
        assert not answers
    queryable.undeclare()
