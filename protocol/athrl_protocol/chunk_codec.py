"""Chunks as bytes: one protobuf bytes field a column, the images compressed (`image_codec`).

Decoding copies nothing but the images: every other column is a read-only view into the message. Nothing
is decompressed before the size that the message announces has been checked.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from athrl_protocol import athrl_pb2
from athrl_protocol.chunk import (
    MAXIMUM_COLUMN_BYTES,
    MAXIMUM_IMAGES_BYTES,
    MAXIMUM_LEVELS,
    MAXIMUM_TIME,
    Chunk,
    LevelColumns,
    check_chunk,
)
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.image_codec import Compression, number_of, pack_images, unpack_images
from athrl_protocol.schema import decode_message, encode_message

# The worst case of either compression is the content plus 1/255; what is longer is not worth a look.
MAXIMUM_MESSAGE_BYTES = MAXIMUM_IMAGES_BYTES + MAXIMUM_IMAGES_BYTES // 128
OLDEST_HELD_BYTES = 16
"""What `with_oldest_held` adds at most."""

_FLOAT32 = np.dtype("<f4")
_INT64 = np.dtype("<i8")
# The images go behind the rest of the message, as any order of fields is the same message; so they are copied
# once and not by each step of protobuf's.
_IMAGES_TAG = bytes([athrl_pb2.Chunk.IMAGES_FIELD_NUMBER << 3 | 2])  # 2: with a length


def encode_chunk(chunk: Chunk, compression: Compression = "zstd") -> bytes:
    """Return the chunk as a message.

    Raises:
        InvalidMessage: the chunk itself is not valid, see `check_chunk`.
    """
    check_chunk(chunk)
    return encode_checked(chunk, Identity.of(chunk), compression)


class Identity(NamedTuple):
    """As what a chunk is sent: by whom, as which of theirs, and what else they hold."""

    actor: str
    incarnation: int
    sequence: int
    oldest_held: int = 0

    @classmethod
    def of(cls, chunk: Chunk) -> Identity:
        """The chunk's own."""
        return cls(chunk.actor, chunk.incarnation, chunk.sequence, chunk.oldest_held)


def encode_checked(chunk: Chunk, identity: Identity, compression: Compression) -> bytes:
    """Return a chunk that `check_chunk` has been happy with as a message, under another identity."""
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
    return b"".join((encode_message(message), _IMAGES_TAG, _varint(len(images)), images))


def _varint(number: int) -> bytes:
    content = bytearray()
    while number > 0x7F:
        content.append(number & 0x7F | 0x80)
        number >>= 7
    content.append(number)
    return bytes(content)


def with_oldest_held(encoded: bytes, oldest_held: int) -> bytes:
    """Return an encoded chunk, which has `oldest_held` 0, with that number and without encoding it again.

    Messages that follow each other merge, and the last value of a field counts (protobuf's encoding
    guide, "Last One Wins").
    """
    return encoded + athrl_pb2.Chunk(oldest_held=oldest_held).SerializeToString() if oldest_held else encoded


def decode_chunk(payload: bytes) -> Chunk:
    """Return the chunk in a message; its arrays are read-only.

    Raises:
        InvalidMessage: the message is malformed, of another schema, too large, or its chunk is not valid.
    """
    if len(payload) > MAXIMUM_MESSAGE_BYTES:
        raise InvalidMessage("size", f"chunk: {len(payload)} bytes, at most {MAXIMUM_MESSAGE_BYTES}")
    message = decode_message(athrl_pb2.Chunk, payload)
    if not 1 <= message.time <= MAXIMUM_TIME or len(message.levels) > MAXIMUM_LEVELS:
        raise InvalidMessage(
            "shape", f"chunk: time {message.time} with {len(message.levels)} levels is out of bounds"
        )
    if not 1 <= message.state_interval <= message.time:
        raise InvalidMessage(
            "shape", f"chunk: state_interval is {message.state_interval}, should divide time = {message.time}"
        )
    chunk = Chunk(
        actor=message.actor,
        incarnation=message.incarnation,
        sequence=message.sequence,
        environment=message.environment,
        episode_seed=message.episode_seed,
        first_step=message.first_step,
        length=message.length,
        state_interval=message.state_interval,
        images=_images(message),
        motion=_column("motion", message.motion, _FLOAT32, (message.time + 1, message.motion_size)),
        levels=_levels(message),
        policy_version=_column("policy_version", message.policy_version, _INT64, (message.time,)),
        terminated=message.terminated,
        truncated=message.truncated,
        oldest_held=message.oldest_held,
    )
    check_chunk(chunk)
    return chunk


def _levels(message: athrl_pb2.Chunk) -> dict[str, LevelColumns]:
    levels: dict[str, LevelColumns] = {}
    sequences = message.time // message.state_interval
    for level in message.levels:
        if level.name in levels:
            raise InvalidMessage("shape", f"chunk: level {level.name!r} comes twice")
        size = len(level.states) // (sequences * _FLOAT32.itemsize)
        levels[level.name] = LevelColumns(
            actions=_column("actions", level.actions, _FLOAT32, (message.time, level.action_size)),
            rewards=_column("rewards", level.rewards, _FLOAT32, (message.time,)),
            states=_column("states", level.states, _FLOAT32, (sequences, size)),
        )
    return levels


def _column(name: str, content: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """Return a read-only view of the shape on a field's bytes."""
    expected = dtype.itemsize
    for size in shape:
        expected *= size
    if expected > MAXIMUM_COLUMN_BYTES or len(content) != expected:
        raise InvalidMessage(
            "size",
            f"chunk: {name} has {len(content)} bytes, {list(shape)} needs {expected} "
            f"(at most {MAXIMUM_COLUMN_BYTES} are allowed)",
        )
    return np.frombuffer(content, dtype).reshape(shape)


def _images(message: athrl_pb2.Chunk) -> npt.NDArray[np.uint8]:
    shape = (message.time + 1, message.image_height, message.image_width, message.image_channels)
    expected = shape[0] * shape[1] * shape[2] * shape[3]
    if not 0 < expected <= MAXIMUM_IMAGES_BYTES:
        raise InvalidMessage(
            "size", f"chunk: images of {expected} bytes, should be 1 to {MAXIMUM_IMAGES_BYTES}"
        )
    content = unpack_images(message.images, message.image_compression, expected)
    return np.frombuffer(content, np.uint8).reshape(shape)
