"""Broken recordings: bytes, records inside the chunks, and fields of the frames inside these."""

from __future__ import annotations

import functools
import logging
import random
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import lz4.frame
import numpy as np
import rerun as rr
import zstandard
from athrl_driving.errors import DrivingError
from athrl_evaluator.drawing import APPLICATION, SceneDrawing
from athrl_evaluator.recording.origin import Origin
from athrl_evaluator.recording.reading import InvalidRecording, read_driven, read_frames
from athrl_evaluator.recording.recordings import FRAME_TOPIC, EpisodeRecording
from athrl_protocol import Frame, Point, Vehicle
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, McapRecord, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from benchmarks.fuzz import mutations
from benchmarks.fuzz.frame import Parser, file_parser
from benchmarks.fuzz.messages import Target, changed_field

_MAGIC = b"\x89MCAP0\r\n"
_PACK: dict[str, Callable[[bytes], bytes]] = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}
_ODD_SIZES = [0, 1, 100, 2**16, 2**24 + 1, 2**31, 2**32, 2**63, 2**64 - 1]


def recording(folder: Path) -> Parser:
    """Return the parser of recorded episodes, which draws what it reads, and reads how it was driven."""
    proper = folder / "proper.mcap"
    seeds = [_episode(proper)]
    known = {frame.SerializeToString(deterministic=True) for frame in read_frames(proper)}
    stream = rr.RecordingStream(APPLICATION)
    stream.save(folder / "drawn.rrd")
    drawing = SceneDrawing(stream)

    def draw(path: Path) -> None:
        with _without_warnings():
            for frame in read_frames(path):
                if frame.SerializeToString(deterministic=True) not in known:  # the same picture takes long
                    drawing.draw(frame)
            read_driven(path)

    breaks = [*mutations.BYTES, changed_records, changed_records, changed_frames, changed_frames]
    return file_parser(seeds, breaks, folder / "some.mcap", draw, InvalidRecording, DrivingError)


@contextmanager
def _without_warnings() -> Iterator[None]:
    """Say nothing of damage behind the first frames."""
    log = logging.getLogger(read_frames.__module__)
    log.disabled = True
    try:
        yield
    finally:
        log.disabled = False


def changed_records(chance: random.Random, content: bytes) -> bytes:
    """Return the file with a record inside a chunk, or the chunk itself, that is odd, missing or repeated."""
    records = _records(content)
    for _ in range(chance.choice([1, 1, 2, 4])):
        place = chance.randrange(len(records))
        match chance.randrange(5):
            case 0:
                del records[place]
            case 1:
                records[place:place] = [records[place]] * chance.choice([1, 500])
            case 2:
                other = chance.randrange(len(records))
                records[place], records[other] = records[other], records[place]
            case _:
                records[place] = _odd(chance, records[place])
        if not records:
            break
    return _file(chance, records)


def changed_frames(chance: random.Random, content: bytes) -> bytes:
    """Return the file with a frame that has fields at their bounds and beyond."""
    records = _records(content)
    frames = [place for place, each in enumerate(records) if isinstance(each, Message)]
    place = chance.choice(frames)
    message = records[place]
    assert isinstance(message, Message)
    try:
        data = changed_field(chance, Target(message.data, Frame, bytes))
    except Exception:  # it is no frame
        data = mutations.changed_bytes(chance, message.data)
    records[place] = replace(message, data=data)
    return _file(chance, records)


def _episode(path: Path) -> bytes:
    """Return a recording of two frames."""
    origin = Origin(1, {"town": "town02"}, "0" * 64, "0" * 16, "2.4", "0.2", "x86_64")
    recording = EpisodeRecording(path, origin)
    car = {"x": 10.0, "y": 20.0, "heading": 0.3, "speed": 5.0, "length": 4.9, "width": 2.1}
    for step in (1, 2):
        frame = Frame(
            driver="policy", town="town02", step=step, time=0.4 * step, ego=Vehicle(**car),
            vehicles=[Vehicle(**car)] * 3, route=[Point(x=1.0, y=2.0)] * 4, waypoint=Point(x=3.0, y=4.0),
            target_speed=4.0, decision={"intention": 1.0}, reward_terms={"speed": 1.0}, image_height=8,
            image_width=8, birdeye=bytes(192), lidar=bytes(64),
        )  # fmt: skip
        recording.write(frame, np.array([0.1, 0.2], np.float32))
    recording.finish()
    return path.read_bytes()


def _records(content: bytes) -> list[McapRecord]:
    """Return what is in the chunks of a proper file."""
    chunks = [
        each for each in StreamReader(BytesIO(content), emit_chunks=True).records if isinstance(each, Chunk)
    ]
    return [each for chunk in chunks for each in breakup_chunk(chunk)]


def _odd(chance: random.Random, record: McapRecord) -> McapRecord:
    match record:
        case Message():
            return chance.choice(
                [
                    replace(record, channel_id=chance.randrange(2**16)),
                    replace(record, data=mutations.changed_bytes(chance, record.data)),
                    replace(record, data=b""),
                ]
            )
        case Channel():
            return replace(record, topic=chance.choice(["", FRAME_TOPIC, "\0", "x" * 70_000]))
    return record


@functools.cache
def _bomb(kind: str) -> bytes:
    """Return 32 MiB, packed; kept, since that takes longer than all that is tried with it."""
    return _PACK[kind](bytes(2**25))


def _file(chance: random.Random, records: list[McapRecord]) -> bytes:
    """Return a file of one chunk, which now and then is not what it says."""
    builder = RecordBuilder()
    for each in records:
        each.write(builder)
    data = builder.end()
    size, checksum = len(data), zlib.crc32(data)
    kind = chance.choice(["zstd", "zstd", "lz4", "", "zip"])
    packed = _PACK.get(kind, bytes)(data)
    if chance.random() < 0.2:
        size = chance.choice(_ODD_SIZES)
    if kind in _PACK and chance.random() < 0.1:
        packed, checksum = _bomb(kind), 0
    Chunk(kind, packed, 0, 0, checksum, size).write(builder)
    end = struct.pack("<BQI", 15, 4, 0)
    return _MAGIC + builder.end() + end
