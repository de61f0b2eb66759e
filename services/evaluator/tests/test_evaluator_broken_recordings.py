"""A recording from elsewhere costs little memory and time, and ends in one line, whatever is in it."""

from __future__ import annotations

import logging
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from athrl_evaluator.recording import reading
from athrl_evaluator.recording.reading import InvalidRecording, read_frames
from athrl_protocol import Frame, encode_frame
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Message
from mcap.stream_reader import MAGIC_SIZE
from mcap.writer import RecordBuilder

MAGIC = b"\x89MCAP0\r\n"


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def written(*records: object) -> bytes:
    builder = RecordBuilder()
    for each in records:
        each.write(builder)  # type: ignore[attr-defined]
    return builder.end()


def message(content: bytes) -> bytes:
    channel = Channel(1, "/frame", "protobuf", {}, 0)
    return written(channel, Message(1, 0, content, 0, 0))


FRAME = message(encode_frame(Frame(driver="blind", town="town02")))


def chunk(content: bytes, compression: str = "zstd", pack: Callable = zstandard.compress, **changes) -> bytes:
    told = {"uncompressed_crc": zlib.crc32(content), "uncompressed_size": len(content)} | changes
    return written(Chunk(compression, pack(content), 0, 0, **told))


def file_of(folder: Path, *parts: bytes) -> Path:
    path = folder / "some.mcap"
    path.write_bytes(MAGIC + b"".join(parts) + written(DataEnd(0)))
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InvalidRecording) as caught:
        list(read_frames(path))
    (line,) = str(caught.value).splitlines()
    assert line.startswith(f"{path} is not a recorded episode")
    return line


@pytest.mark.parametrize(
    ("compression", "pack"), [("zstd", zstandard.compress), ("lz4", lz4.frame.compress), ("", bytes)]
)
def test_chunks_of_every_compression_of_the_format_are_read(
    tmp_path: Path, compression: str, pack: Callable
) -> None:
    assert len(MAGIC) == MAGIC_SIZE
    (frame,) = read_frames(file_of(tmp_path, chunk(FRAME, compression, pack)))
    assert frame.driver == "blind"


def streamed(content: bytes) -> bytes:
    """Pack without a size that is announced."""
    return zstandard.ZstdCompressor(write_content_size=False).compress(content)


@pytest.mark.parametrize("announced", [1000, 2**31, 2**63])
@pytest.mark.parametrize(
    ("compression", "pack"),
    [("zstd", zstandard.compress), ("zstd", streamed), ("lz4", lz4.frame.compress)],
    ids=["zstd", "zstd-streamed", "lz4"],
)
def test_a_chunk_that_unpacks_to_gigabytes_takes_little_memory(
    tmp_path: Path, compression: str, pack: Callable, announced: int
) -> None:
    packed = pack(bytes(4 * reading.LARGEST_CHUNK))
    path = file_of(tmp_path, chunk(b"", compression, lambda _: packed, uncompressed_size=announced))
    tracemalloc.start()
    try:
        assert "chunk" in refusal(path) or "ecompress" in refusal(path)
        assert tracemalloc.get_traced_memory()[1] < reading.LARGEST_CHUNK
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (chunk(FRAME, "brotli", bytes), "a chunk is packed as 'brotli'; it should be zstd or lz4"),
        (chunk(FRAME, uncompressed_crc=7), "a chunk's checksum is wrong"),
        (chunk(FRAME, uncompressed_size=len(FRAME) + 1), "a chunk does not have the size that it states"),
        (chunk(FRAME, pack=lambda content: b"no zstd" + content), "damaged"),
        (chunk(FRAME, "lz4", bytes), "damaged"),
        (struct.pack("<BQ", Opcode.CHUNK, 2**64 - 1), "it ends within a record"),
        (record(Opcode.CHUNK, b"\xff" * 60), "damaged"),
        (record(Opcode.CHANNEL, struct.pack("<HHI", 1, 0, 2**32 - 1)), "damaged"),
        (record(Opcode.CHANNEL, struct.pack("<HHI", 1, 0, 3) + b"\xff\xfe\xfd"), "UTF-8"),
        (written(Channel(1, "/frame", "protobuf", {}, 0)) + record(Opcode.MESSAGE, b"\x01\0"), "damaged"),
        (message(b"\xff\xff\xff"), "of this release: Frame: 3 bytes that are no such message"),
        (message(b""), "of this release: Frame: schema 0"),
        (written(Channel(1, "/frame", "protobuf", {}, 0)), "it has no /frame"),
    ],
)
def test_a_file_that_no_recorder_writes_is_one_line(tmp_path: Path, content: bytes, said: str) -> None:
    assert said in refusal(file_of(tmp_path, content))


def test_a_file_of_very_many_records_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "MOST_RECORDS", 1000)
    assert "over 1,000 records" in refusal(file_of(tmp_path, chunk(record(200, b"") * 1001)))


def test_the_frames_before_the_damage_are_shown(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = file_of(tmp_path, chunk(FRAME), chunk(FRAME), chunk(FRAME, uncompressed_crc=7), chunk(FRAME))
    with caplog.at_level(logging.WARNING):
        assert len(list(read_frames(path))) == 2
    assert f"{path} is cut short or damaged after 2 frames" in caplog.text


@pytest.mark.parametrize("time", [float("nan"), float("inf"), 1e300])
def test_a_frame_that_cannot_be_drawn_is_one_line(tmp_path: Path, time: float) -> None:
    assert "time" in refusal(file_of(tmp_path, message(encode_frame(Frame(time=time)))))
