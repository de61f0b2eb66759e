"""Names and headers of segments, and what a checkpoint says about them."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

_NAME = re.compile(r"segment-([0-9]{8,18})\.log")
_MAGIC = b"ATHRLSEG"
#: Incremented when the layout of a segment changes.
FORMAT = 1
_FIELDS = struct.Struct("<8sI4xQQ")
_CHECKSUM = struct.Struct("<I")
SEGMENT_HEADER_BYTES = _FIELDS.size + _CHECKSUM.size
LARGEST_NUMBER = 10**15
"""Of a segment, record, checkpoint or policy in a folder from elsewhere, so that there is room for more."""
MOST_SEGMENT_BYTES = 2**30 + 2**27
"""The largest `durability.segment_mebibytes` and a record that begins within it."""


@dataclass(frozen=True)
class SegmentFacts:
    """Facts about a sealed segment.

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
    """The end of the log at the time of a checkpoint, and the part of it that is the replay.

    Attributes:
        next_segment: segments from this number on were written after the checkpoint.
        next_record: the same for records.
        oldest: number of the record with the oldest sequence in the replay; `next_record` if it is empty.
        oldest_left: how many sequences of that record, its last ones, are in the replay.
        segments: the segments that hold the records from `oldest` on, oldest first.
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
        """Read what `to_json` returned; raises KeyError, TypeError or ValueError for anything else."""
        position = cls(
            count_of(values["next_segment"]),
            count_of(values["next_record"]),
            count_of(values["oldest"]),
            count_of(values["oldest_left"]),
            tuple(_facts(**facts) for facts in values["segments"]),
        )
        for facts in position.segments:
            if facts.number >= position.next_segment or facts.first + facts.records > position.next_record:
                raise ValueError(f"it names segment {facts.number}, which is after the end of its log")
        return position


def _facts(number: Any, first: Any, records: Any, bytes: Any, checksum: Any) -> SegmentFacts:
    if not isinstance(checksum, str):
        raise TypeError(f"a checksum is {checksum!r:.60}, should be text")
    return SegmentFacts(count_of(number), count_of(first), count_of(records), count_of(bytes), checksum)


def count_of(value: Any, least: int = 0) -> int:
    """Return a count that was read from a file; raises ValueError unless it is an integer of 64 bits."""
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value < 2**63:
        raise ValueError(f"a count is {value!r:.60}, should be an integer from {least} to 2^63 - 1")
    return value


def segment_name(number: int) -> str:
    """The file name of segment `number`."""
    return f"segment-{number:08d}.log"


def numbered_segments(folder: Path) -> dict[int, Path]:
    """All segments in `folder` by their numbers, oldest first."""
    found = []
    for path in folder.iterdir() if folder.is_dir() else ():
        match = _NAME.fullmatch(path.name)
        if match and int(match[1]) <= LARGEST_NUMBER:
            found.append((int(match[1]), path))
    return dict(sorted(found))


def encode_segment_header(number: int, first: int) -> bytes:
    """The header of segment `number`, whose first record will be `first`."""
    fields = _FIELDS.pack(_MAGIC, FORMAT, number, first)
    return fields + _CHECKSUM.pack(zlib.crc32(fields))


def decode_segment_header(content: memoryview) -> tuple[int, int, int] | None:
    """(format, number, first record), or None if the header is damaged or cut off."""
    raw = content[:SEGMENT_HEADER_BYTES]
    if len(raw) < SEGMENT_HEADER_BYTES:
        return None
    magic, layout, number, first = _FIELDS.unpack(raw[: _FIELDS.size])
    if max(number, first) > LARGEST_NUMBER:
        return None
    if magic != _MAGIC or zlib.crc32(raw[: _FIELDS.size]) != _CHECKSUM.unpack(raw[_FIELDS.size :])[0]:
        return None
    return layout, number, first
