"""Broken messages for every decoder: each must be refused as `InvalidMessage`, or be a proper one.

Valid messages of every kind are changed: bits and bytes, lengths, pieces of other messages, fields with
values at and beyond their bounds, numbers that are none, images that unpack to something else. What a decoder
lets through is checked again: a chunk goes through the learner's own check of what fits its run, and
everything that would go into the replay has the shape, the type and the range it should have.
"""

from __future__ import annotations

import functools
import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zstandard
from athrl_learner.intake.chunk_validation import ChunkReader
from athrl_planners import Sequence
from athrl_protocol import (
    Chunk,
    Frame,
    InvalidMessage,
    LevelColumns,
    Vehicle,
    decode_chunk,
    decode_frame,
    encode_chunk,
    encode_frame,
)
from athrl_protocol.announcements import evaluation, policy, state
from athrl_protocol.announcements.metrics import decode_metrics
from athrl_protocol.delivery.ledger import Ledger
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.schema import decode_message, encode_message
from athrl_spaces import (
    WAYPOINT,
    Continuous,
    LevelDescription,
    Limits,
    Observation,
    PolicyDescription,
    action_kind,
)
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

from benchmarks.fuzz import mutations
from benchmarks.fuzz.frame import Mutation, Parser

LENGTH, SEQUENCES, SIZE = 10, 2, 32
TIME = LENGTH * SEQUENCES
LONGEST = 2 * TIME
LARGEST = 1e5
"""Of anything that may go into the replay."""

_EXTREMES = [0, 1, 2, 7, 255, 1024, 2**16, 2**31 - 1, 2**32 - 1]
_FLOATS = [0.0, -0.0, 1e30, -1e30, float("nan"), float("inf"), float("-inf"), 1e-45, 3.4e38]


class Target(NamedTuple):
    """A kind of message: an example, its class, and what a receiver does with it."""

    example: bytes
    kind: type[Message]
    receive: Callable[[bytes], object]


def observation() -> Observation:
    """Return what the fuzzed run's planner perceives."""
    return Observation(SIZE)


def reader() -> ChunkReader:
    """Return the learner's check of what fits its run."""
    limits = Limits()
    levels = (
        LevelDescription("intention", (Continuous("intention", "", 0.0, 2.0),), 8),
        LevelDescription("trajectory", action_kind(WAYPOINT).describe(limits), 8),
    )
    return ChunkReader(PolicyDescription("fuzzed", WAYPOINT, limits, observation(), levels), LENGTH, LONGEST)


def example_chunk(generator: np.random.Generator) -> Chunk:
    """Return a chunk that fits the run."""

    def floats(*shape: int) -> np.ndarray:
        return generator.uniform(0, 1, shape).astype(np.float32)

    settings = observation()
    return Chunk(
        actor="rig-1",
        incarnation=2**60,
        sequence=0,
        environment=3,
        episode_seed=2**40,
        first_step=8,
        length=TIME,
        state_interval=LENGTH,
        images=generator.integers(0, 2, (TIME + 1, *settings.image_shape), dtype=np.uint8),
        motion=floats(TIME + 1, settings.motion_size),
        levels={
            "intention": LevelColumns(floats(TIME, 1), floats(TIME), floats(SEQUENCES, 8)),
            "trajectory": LevelColumns(0.5 * floats(TIME, 2), floats(TIME), floats(SEQUENCES, 8)),
        },
        policy_version=np.arange(TIME, dtype=np.int64),
        terminated=False,
        truncated=True,
    )


class ChunkReceiver:
    """Does with a chunk what the learner does before it touches the replay, and doubts the result."""

    def __init__(self) -> None:
        self._reader = reader()
        self._ledger = Ledger()

    def __call__(self, payload: bytes) -> object:
        """Return what would go into the replay."""
        chunk = decode_chunk(payload)
        self._ledger.classify(chunk)
        sequences = self._reader.sequences(chunk)
        assert 1 <= len(sequences) <= LONGEST // LENGTH
        for sequence in sequences:
            _doubt(sequence)
        return sequences


def _doubt(sequence: Sequence) -> None:
    """Look whether it may go into the replay."""
    assert sequence.images.dtype == np.uint8
    assert sequence.images.shape == (LENGTH + 1, *observation().image_shape)
    for columns in (sequence.actions, sequence.rewards, sequence.initial_state):
        for column in columns.values():
            assert column.dtype == np.float32
            assert (np.abs(column) <= LARGEST).all()  # a number that is none is not
    assert (np.abs(sequence.motion) <= LARGEST).all()
    assert 1 <= sequence.length <= LENGTH


def targets() -> list[Target]:
    """Return every kind of message that somebody receives."""
    generator = np.random.default_rng(0)
    numbers = {f"metric/{number}": float(number) for number in range(20)}
    frame = Frame(
        driver="policy", town="town03", vehicles=[Vehicle(x=1.0)] * 20, image_height=4, image_width=4
    )
    frame.birdeye, frame.lidar = bytes(48), bytes(16)
    run_state = state.RunState(state.Phase.TRAINING, 1, 2, 3, 4, "actors wait")
    result = evaluation.EvaluationResult("policy", 1, 2, "town03", 3, numbers)
    update = policy.PolicyUpdate(3, bytes(500), False, 1.0, 1, 2, 3.0)
    chunk = Target(encode_chunk(example_chunk(generator)), athrl_pb2.Chunk, ChunkReceiver())
    plain = [
        (athrl_pb2.Acknowledgement(next_sequence=3, credits=8), athrl_pb2.Acknowledgement),
        (athrl_pb2.Refusal(reason=athrl_pb2.Refusal.BUSY, text="busy"), athrl_pb2.Refusal),
        (athrl_pb2.Version(incarnation=1, number=2), athrl_pb2.Version),
    ]
    metrics = athrl_pb2.Metrics(role="actor", name="rig-1", time=1.0, values=numbers)
    return [
        chunk,
        chunk,  # what matters most comes most often
        chunk,
        Target(encode_frame(frame), Frame, decode_frame),
        Target(encode_message(metrics), athrl_pb2.Metrics, decode_metrics),
        Target(evaluation._encode(result), athrl_pb2.Evaluation, evaluation._decode),
        Target(policy._encode(update), athrl_pb2.Policy, policy._decode),
        Target(state._encode(run_state), athrl_pb2.RunState, state._decode),
        *(
            Target(encode_message(message), kind, lambda payload, kind=kind: decode_message(kind, payload))
            for message, kind in plain
        ),
    ]


def changed_field(chance: random.Random, target: Target) -> bytes:
    """Return the message with fields set to values at their bounds and beyond."""
    message = target.kind()
    message.ParseFromString(target.example)
    for _ in range(chance.choice([1, 1, 1, 2, 4])):
        _change(chance, message)
    return message.SerializeToString()


def changed_numbers(chance: random.Random, target: Target) -> bytes:
    """Return the message with a float32 in its columns that is none, or far out."""
    message = target.kind()
    message.ParseFromString(target.example)
    if not isinstance(message, athrl_pb2.Chunk):
        return changed_field(chance, target)
    level = chance.choice(message.levels)
    holder, name = chance.choice(
        [(message, "motion"), (level, "actions"), (level, "rewards"), (level, "states")]
    )
    column = bytearray(getattr(holder, name))
    struct.pack_into("<f", column, 4 * chance.randrange(len(column) // 4), chance.choice(_FLOATS[2:]))
    setattr(holder, name, bytes(column))
    return message.SerializeToString()


def changed_images(chance: random.Random, target: Target) -> bytes:
    """Return a chunk whose images unpack to something else: too much, too little, nothing, for ever."""
    message = target.kind()
    message.ParseFromString(target.example)
    if not isinstance(message, athrl_pb2.Chunk):
        return mutations.changed_bytes(chance, target.example)
    message.images = _compressed(chance.choice([0, 1, 1000, 2**20, 2**26]), chance.random() < 0.5)
    if chance.random() < 0.3:
        message.time = chance.choice(_EXTREMES)
    if chance.random() < 0.3:
        message.image_height = chance.choice(_EXTREMES)
    return message.SerializeToString()


@functools.cache
def _compressed(size: int, announced: bool) -> bytes:
    """Return so many bytes, compressed; kept, since that takes longer than all that is tried with it."""
    return zstandard.ZstdCompressor(level=1, write_content_size=announced).compress(bytes(size))


def _change(chance: random.Random, message: Message) -> None:
    """Set one field, of the message itself or of one inside it, to something that may not be."""
    field: FieldDescriptor = chance.choice(list(message.DESCRIPTOR.fields))
    if field.is_repeated:
        _change_repeated(chance, message, field)
    elif field.message_type is not None:
        _change(chance, getattr(message, field.name))
    else:
        setattr(message, field.name, _value(chance, field, getattr(message, field.name)))


def _change_repeated(chance: random.Random, message: Message, field: FieldDescriptor) -> None:
    values: Any = getattr(message, field.name)
    if field.message_type.GetOptions().map_entry:
        for value in chance.choices(_FLOATS, k=chance.choice([1, 3, 3_000])):
            values[str(chance.random())] = value
    elif chance.random() < 0.5 and len(values):
        _change(chance, chance.choice(values))
    elif chance.random() < 0.5:
        del values[chance.randrange(len(values) + 1) :]
    else:
        for _ in range(chance.choice([1, 20, 5_000])):
            values.add()


def _value(chance: random.Random, field: FieldDescriptor, now: Any) -> Any:
    kinds = FieldDescriptor
    if field.cpp_type in (kinds.CPPTYPE_DOUBLE, kinds.CPPTYPE_FLOAT):
        return chance.choice(_FLOATS)
    if field.cpp_type == kinds.CPPTYPE_BOOL:
        return not now
    if field.type == kinds.TYPE_STRING:
        return chance.choice(["", "x" * 5_000, "a/b", "../..", "\n\x1b[2J", "*", "héros", now + "\0"])
    if field.type == kinds.TYPE_BYTES:
        return chance.choice([b"", now[:-1], now + b"\0", now + now, now[: len(now) // 2], bytes(len(now))])
    largest = 2**32 - 1 if field.cpp_type == kinds.CPPTYPE_UINT32 else 2**64 - 1
    if field.cpp_type == kinds.CPPTYPE_ENUM:
        largest = 2**31 - 1
    return chance.choice([*(value for value in _EXTREMES if value <= largest), largest, max(0, now - 1)])


def of_bytes(mutation: Mutation) -> Callable[[random.Random, Target], bytes]:
    """Return the mutation of the bytes of a message."""
    return lambda chance, target: mutation(chance, target.example)


MUTATIONS = [
    of_bytes(mutations.random_bytes),
    of_bytes(mutations.changed_bytes),
    of_bytes(mutations.cut_or_stretched),
    changed_field,
    changed_field,
    changed_numbers,
    changed_images,
]


class Piece(NamedTuple):
    """Bytes that come as a message of some kind."""

    target: Target
    payload: bytes


def parser(folder: Path) -> Parser:
    """Return the parser of all messages; it needs no folder."""
    kinds = targets()

    def broken(chance: random.Random) -> Piece:
        target = chance.choice(kinds)
        return Piece(target, chance.choice(MUTATIONS)(chance, target))

    def receive(piece: Piece) -> object:
        return piece.target.receive(piece.payload)

    return Parser([Piece(target, target.example) for target in kinds], broken, receive, (InvalidMessage,))
