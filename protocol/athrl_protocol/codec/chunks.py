"""Chunks as bytes: one protobuf bytes field a column, the images compressed (`codec.images`).

Decoded columns are read-only views, of the message itself if its images are not compressed. Nothing is
decompressed before the announced size has been checked.
"""

from __future__ import annotations

from math import prod
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from athrl_protocol.codec.image_position import split_images, with_images_first
from athrl_protocol.codec.images import Compression, number_of, pack_images, unpack_images
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.chunk import (
    MAXIMUM_COLUMN_BYTES,
    MAXIMUM_IMAGES_BYTES,
    MAXIMUM_LEVELS,
    MAXIMUM_TIME,
    Chunk,
    LevelColumns,
    check_chunk,
)
from athrl_protocol.messages.schema import decode_message

# The worst case of both compressions is the content plus 1/255; longer messages are refused.
MAXIMUM_MESSAGE_BYTES = MAXIMUM_IMAGES_BYTES + MAXIMUM_IMAGES_BYTES // 128
OLDEST_HELD_BYTES = 16
"""Most bytes that `with_oldest_held` adds."""

_FLOAT32 = np.dtype("<f4")
_INT64 = np.dtype("<i8")


def encode_chunk(chunk: Chunk, compression: Compression = "zstd") -> bytes:
    """Return the chunk as a message.

    Raises:
        InvalidMessage: the chunk is not valid, see `check_chunk`.
    """
    check_chunk(chunk)
    return encode_checked(chunk, Identity.of(chunk), compression)


class Identity(NamedTuple):
    """Identity of a sent chunk: its actor, incarnation and sequence, and the oldest chunk held."""

    actor: str
    incarnation: int
    sequence: int
    oldest_held: int = 0

    @classmethod
    def of(cls, chunk: Chunk) -> Identity:
        """The identity in the chunk itself."""
        return cls(chunk.actor, chunk.incarnation, chunk.sequence, chunk.oldest_held)


def encode_checked(chunk: Chunk, identity: Identity, compression: Compression) -> bytes:
    """Return a chunk, already checked by `check_chunk`, as a message with another identity."""
    _, height, width, channels = chunk.images.shape
    message = athrl_pb2.Chunk(
        actor=identity.actor,
        incarnation=identity.incarnation,
        sequence=identity.sequence,
        environment=chunk.environment,
        episode_seed=chunk.episode_seed,
        first_step=chunk.first_step,
        time=chunk.time,
        length=chunk.length,
        state_interval=chunk.state_interval,
        image_height=height,
        image_width=width,
        image_channels=channels,
        motion_size=chunk.motion.shape[1],
        image_compression=number_of(compression),
        motion=chunk.motion.astype(_FLOAT32, copy=False).tobytes(),
        policy_version=chunk.policy_version.astype(_INT64, copy=False).tobytes(),
        terminated=chunk.terminated,
        truncated=chunk.truncated,
        oldest_held=identity.oldest_held,
    )
    for name, level in chunk.levels.items():
        message.levels.add(
            name=name,
            action_size=level.actions.shape[1],
            actions=level.actions.astype(_FLOAT32, copy=False).tobytes(),
            rewards=level.rewards.astype(_FLOAT32, copy=False).tobytes(),
            states=level.states.astype(_FLOAT32, copy=False).tobytes(),
        )
    images = pack_images(chunk.images, compression)
    return with_images_first(message, images)


def with_oldest_held(encoded: bytes, oldest_held: int) -> bytes:
    """Set `oldest_held` of an encoded chunk, which has 0, without encoding it again.

    Concatenated messages merge, and the last value of a field counts (protobuf's encoding guide, "Last One
    Wins").
    """
    return encoded + athrl_pb2.Chunk(oldest_held=oldest_held).SerializeToString() if oldest_held else encoded


def decode_chunk(payload: bytes, most_image_bytes: int = MAXIMUM_IMAGES_BYTES) -> Chunk:
    """Return the chunk in a message; its arrays are read-only.

    Args:
        payload: the message.
        most_image_bytes: of its images; more are not unpacked.

    Raises:
        InvalidMessage: the message is malformed, of another schema, too large, or its chunk is not valid.
    """
    if len(payload) > MAXIMUM_MESSAGE_BYTES:
        raise InvalidMessage("size", f"chunk: {len(payload)} bytes, at most {MAXIMUM_MESSAGE_BYTES}")
    images, rest = split_images(payload)
    message = decode_message(athrl_pb2.Chunk, rest)
    time, interval = message.time, message.state_interval
    if not 1 <= time <= MAXIMUM_TIME or len(message.levels) > MAXIMUM_LEVELS:
        raise InvalidMessage(
            "shape", f"chunk: time {time} with {len(message.levels)} levels is out of bounds"
        )
    if not 1 <= interval <= time:
        raise InvalidMessage("shape", f"chunk: state_interval is {interval}, should divide time = {time}")
    chunk = Chunk(
        actor=message.actor,
        incarnation=message.incarnation,
        sequence=message.sequence,
        environment=message.environment,
        episode_seed=message.episode_seed,
        first_step=message.first_step,
        length=message.length,
        state_interval=interval,
        # if a field comes twice, the last one counts
        images=_images(message, time, message.images or images, most_image_bytes),
        motion=_column("motion", message.motion, _FLOAT32, (time + 1, message.motion_size)),
        levels=_levels(message, time, time // interval),
        policy_version=_column("policy_version", message.policy_version, _INT64, (time,)),
        terminated=message.terminated,
        truncated=message.truncated,
        oldest_held=message.oldest_held,
    )
    check_chunk(chunk)
    return chunk


def _levels(message: athrl_pb2.Chunk, time: int, sequences: int) -> dict[str, LevelColumns]:
    levels: dict[str, LevelColumns] = {}
    for level in message.levels:
        name, states = level.name, level.states
        if name in levels:
            raise InvalidMessage("shape", f"chunk: level {name!r} comes twice")
        size = len(states) // (sequences * _FLOAT32.itemsize)
        levels[name] = LevelColumns(
            actions=_column("actions", level.actions, _FLOAT32, (time, level.action_size)),
            rewards=_column("rewards", level.rewards, _FLOAT32, (time,)),
            states=_column("states", states, _FLOAT32, (sequences, size)),
        )
    return levels


def _column(name: str, content: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """Return a read-only view of the shape on a field's bytes."""
    expected = prod(shape) * dtype.itemsize
    if expected > MAXIMUM_COLUMN_BYTES or len(content) != expected:
        raise InvalidMessage(
            "size",
            f"chunk: {name} has {len(content)} bytes, {list(shape)} needs {expected} "
            f"(at most {MAXIMUM_COLUMN_BYTES} are allowed)",
        )
    return np.ndarray(shape, dtype, content)


def _images(
    message: athrl_pb2.Chunk, time: int, images: bytes | memoryview, most: int
) -> npt.NDArray[np.uint8]:
    shape = (time + 1, message.image_height, message.image_width, message.image_channels)
    expected = prod(shape)
    if not 0 < expected <= min(most, MAXIMUM_IMAGES_BYTES):
        raise InvalidMessage(
            "size", f"chunk: images of {expected} bytes, should be 1 to {min(most, MAXIMUM_IMAGES_BYTES)}"
        )
    content = unpack_images(images, message.image_compression, expected)
    return np.ndarray(shape, np.uint8, content)
