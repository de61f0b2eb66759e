"""Reads recorded episodes: MCAP files, which may come from elsewhere.

The records are read here and not by mcap's reader, which believes what a file announces: a chunk of 98 KB
unpacks to gigabytes, and a length of a string is allocated before it is read.
"""

from __future__ import annotations

import logging
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from athrl_protocol import Frame, InvalidMessage, ProtocolError, decode_frame
from athrl_spaces.untrusted import parser_errors, read_untrusted
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata
from numpy.typing import NDArray

from athrl_evaluator.recording.origin import METADATA, ORIGIN_KEYS, Origin
from athrl_evaluator.recording.recordings import ACTION_TOPIC, FRAME_TOPIC

MEBIBYTE = 2**20
LARGEST_RECORDING = 256 * MEBIBYTE
"""Bytes of a file. An episode of 250 decisions has about 1 MB."""
LARGEST_CHUNK = 16 * MEBIBYTE
"""Bytes of an unpacked chunk. Ours have `CHUNK_BYTES` and a decision more, with a frame of 4 MiB at most."""
MOST_UNPACKED = 4096 * MEBIBYTE
"""Bytes of all unpacked chunks, which take some seconds."""
MOST_RECORDS = 1_000_000
"""A decision has seven."""

_MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")

log = logging.getLogger(__name__)


class InvalidRecording(ProtocolError):  # noqa: N818  (the name says what is wrong)
    """A file is not a recorded episode."""


class _Damaged(Exception):  # noqa: N818
    """A file cannot be read any further."""


@dataclass(frozen=True)
class Driven:
    """How a recorded episode was driven.

    Attributes:
        origin: its seed and settings.
        actions: float32 [decisions, 2] as the environment took them.
    """

    origin: Origin
    actions: NDArray[np.float32]


def read_frames(path: Path) -> Iterator[Frame]:
    """The frames of a recording in order; of a truncated or damaged file, all before the damage.

    Raises:
        InvalidRecording: it is no recorded episode, or one of another release.
    """
    return (item for item in _read(path) if isinstance(item, Frame))


def read_driven(path: Path) -> Driven:
    """How the episode of a recording was driven; of a truncated or damaged file, up to the damage.

    Raises:
        InvalidRecording: as `read_frames`, and for a recording that does not say how it was driven.
    """
    frames, texts, actions = 0, dict[str, str](), list[tuple[float, float]]()
    for item in _read(path):
        if isinstance(item, Frame):
            frames += 1
        elif isinstance(item, Vector2):
            actions.append((item.x, item.y))
        else:
            texts |= {key: item.metadata[key] for key in ORIGIN_KEYS & item.metadata.keys()}
    if not texts and not actions:
        raise InvalidRecording(
            f"{path} cannot be driven again: it has no settings, no map's checksum and no actions, "
            "as recordings of older releases; `athrl watch` shows it"
        )
    with parser_errors(
        lambda reason: InvalidRecording(f"{path} cannot be driven again: its origin {reason}")
    ):
        origin = Origin.from_metadata(texts)
    with np.errstate(over="ignore"):
        taken = np.array(actions, np.float32)
    if len(actions) != frames or not np.isfinite(taken).all():
        raise InvalidRecording(
            f"{path} cannot be driven again: it has {len(actions)} actions for {frames} decisions, "
            "it should have a finite one for each"
        )
    return Driven(origin, taken)


def _read(path: Path) -> Iterator[Frame | Vector2 | Metadata]:
    """What is in a recording, in order, with the errors of `read_frames`."""
    with parser_errors(lambda reason: InvalidRecording(f"{path} is not a recorded episode: it {reason}")):
        content = read_untrusted(path, LARGEST_RECORDING)
    count = 0
    try:
        with parser_errors(_Damaged, McapError, zstandard.ZstdError, RuntimeError, DecodeError):  # lz4's too
            for item in _items(memoryview(content)):
                count += isinstance(item, Frame)
                yield item
    except InvalidMessage as error:
        raise InvalidRecording(f"{path} is not a recorded episode of this release: {error}") from None
    except _Damaged as damage:
        if count == 0:
            raise InvalidRecording(
                f"{path} is not a recorded episode: it is cut short before the first frame, damaged, or no "
                f"MCAP file: {damage}"
            ) from None
        log.warning("%s is cut short or damaged after %d frames, which are all that is shown", path, count)
    if count == 0:
        raise InvalidRecording(f"{path} is not a recorded episode: it has no {FRAME_TOPIC}")


def _items(content: memoryview) -> Iterator[Frame | Vector2 | Metadata]:
    topics: dict[int, str] = {}
    for opcode, body in _unpacked_records(content):
        if opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(body)))
            topics[channel.id] = channel.topic
        elif opcode == Opcode.MESSAGE:
            number = _MESSAGE.unpack_from(body)[0]
            if topics.get(number) == FRAME_TOPIC:
                yield decode_frame(bytes(body[_MESSAGE.size :]))
            elif topics.get(number) == ACTION_TOPIC:
                yield Vector2.FromString(bytes(body[_MESSAGE.size :]))
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(ReadDataStream(BytesIO(body)))
            if metadata.name == METADATA:
                yield metadata


def _unpacked_records(content: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of the records up to the end of the data, those inside chunks too."""
    if content[: len(_MAGIC)] != _MAGIC:
        raise ValueError("it does not begin as one")
    records, unpacked = 0, 0
    for outer, body in _records(content[len(_MAGIC) :]):
        if outer == Opcode.DATA_END:
            return
        inner: Iterator[tuple[int, memoryview]] = iter([(outer, body)])
        if outer == Opcode.CHUNK:
            data = _unpack(Chunk.read(ReadDataStream(BytesIO(body))))
            unpacked += len(data)
            inner = _records(memoryview(data))
        for record in inner:
            records += 1
            if records > MOST_RECORDS or unpacked > MOST_UNPACKED:
                raise ValueError(
                    f"it has over {MOST_RECORDS:,} records or {MOST_UNPACKED // MEBIBYTE:,} MiB unpacked"
                )
            yield record
    raise ValueError("its end is missing")


def _records(content: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of each record."""
    place = 0
    while place < len(content):
        opcode, length = 0, len(content)
        if len(content) - place >= _RECORD.size:
            opcode, length = _RECORD.unpack_from(content, place)
        place += _RECORD.size
        if length > len(content) - place:
            raise ValueError("it ends within a record")
        yield opcode, content[place : place + length]
        place += length


def _unpack(chunk: Chunk) -> bytes:
    """The records of a chunk; as many bytes as it announces, or an error."""
    size, packed = chunk.uncompressed_size, chunk.data
    if size > LARGEST_CHUNK:
        raise ValueError(f"a chunk has {size:,} bytes; it should have at most {LARGEST_CHUNK:,}")
    match chunk.compression:
        case "":
            data = packed
        case "zstd":
            if zstandard.frame_content_size(packed) not in (size, -1):  # -1: not announced
                raise ValueError("a chunk does not have the size that it states")
            data = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        case "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
        case other:
            raise ValueError(f"a chunk is packed as {other[:20]!r}; it should be zstd or lz4")
    if len(data) != size:
        raise ValueError("a chunk does not have the size that it states")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):  # 0: none was written
        raise ValueError("a chunk's checksum is wrong")
    return data
