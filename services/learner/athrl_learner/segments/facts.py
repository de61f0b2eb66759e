"""What segments are called, how they begin, and what a checkpoint says about them."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

_NAME = re.compile(r"segment-(\d{8,})\.log")
_MAGIC = b"ATHRLSEG"
#: Raised when a segment is laid out differently from before.
FORMAT = 1
_FIELDS = struct.Struct("<8sI4xQQ")
_CHECKSUM = struct.Struct("<I")
SEGMENT_HEADER_BYTES = _FIELDS.size + _CHECKSUM.size


@dataclass(frozen=True)
class SegmentFacts:
    """A sealed segment.

    Attributes:
        number: of the segment, from 1; its file is named after it.
        first: number of its first record.
        records: how many it holds.
        bytes: of the file.
        checksum: SHA-256 over its records' headers, which hold the checksums of the bodies.
    """

    number: int
    first: int
    records: int
    bytes: int
    checksum: str


@dataclass(frozen=True)
class LogPosition:
    """How far the log was at the moment of a checkpoint, and which part of it is the replay.

    Attributes:
        next_segment: segments with this number and above came after the checkpoint.
        next_record: likewise of records.
        oldest: number of the record with the oldest sequence in the replay; `next_record` if it is empty.
        oldest_left: how many of that record's sequences are in the replay: its last ones.
        segments: those that hold the records from `oldest` on, oldest first.
    """

    next_segment: int
    next_record: int
    oldest: int
    oldest_left: int
    segments: tuple[SegmentFacts, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values for a manifest."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> LogPosition:
        """What `to_json` returned; raises KeyError, TypeError or ValueError if it is something else."""
        return cls(
            int(values["next_segment"]),
            int(values["next_record"]),
            int(values["oldest"]),
            int(values["oldest_left"]),
            tuple(SegmentFacts(**facts) for facts in values["segments"]),
        )


def segment_name(number: int) -> str:
    """The file name of segment `number`."""
    return f"segment-{number:08d}.log"


def numbered_segments(folder: Path) -> dict[int, Path]:
    """All segments in `folder` by their numbers, oldest first."""
    found = []
    for path in folder.iterdir() if folder.is_dir() else ():
        match = _NAME.fullmatch(path.name)
        if match:
            found.append((int(match[1]), path))
    return dict(sorted(found))


def encode_segment_header(number: int, first: int) -> bytes:
    """How the file of segment `number` begins, whose first record will be `first`."""
    fields = _FIELDS.pack(_MAGIC, FORMAT, number, first)
    return fields + _CHECKSUM.pack(zlib.crc32(fields))


def decode_segment_header(content: memoryview) -> tuple[int, int, int] | None:
    """(format, number, first record), or None if the header is damaged or cut off."""
    raw = content[:SEGMENT_HEADER_BYTES]
    if len(raw) < SEGMENT_HEADER_BYTES:
        return None
    magic, layout, number, first = _FIELDS.unpack(raw[: _FIELDS.size])
    if magic != _MAGIC or zlib.crc32(raw[: _FIELDS.size]) != _CHECKSUM.unpack(raw[_FIELDS.size :])[0]:
        return None
    return layout, number, first
