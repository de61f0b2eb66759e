"""Reads a segment: intact records in order, and the positions of damaged ones."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from athrl_spaces.untrusted import parser_errors, read_untrusted

from athrl_learner.errors import CannotResume
from athrl_learner.log.records import HEADER_BYTES, MARKER, Record, header_at
from athrl_learner.log.segments import (
    FORMAT,
    MOST_SEGMENT_BYTES,
    SEGMENT_HEADER_BYTES,
    SegmentFacts,
    decode_segment_header,
)


@dataclass(frozen=True)
class Damage:
    """A part of a segment that cannot be read.

    Attributes:
        path: the segment.
        start: first byte.
        end: byte behind the last.
        number: of the record, if its header is intact.
        torn: the segment ends within the record: it was being written when the learner died.
    """

    path: Path
    start: int
    end: int
    number: int | None = None
    torn: bool = False

    def __str__(self) -> str:
        what = "a record was cut off" if self.torn else "a record is damaged"
        return f"{self.path}: {what} at bytes {self.start} to {self.end}"


class SegmentReader:
    """One pass over a segment; afterwards `facts` describes what was intact.

    Raises:
        CannotResume: the file cannot be read, or has another version of the format.
    """

    def __init__(self, path: Path, number: int, expected_first: int) -> None:
        """Read the file; `expected_first` is the number of its first record if its header is damaged."""
        self._path = path
        with parser_errors(lambda reason: CannotResume(f"segment {path} of the log {reason}")):
            self._content = memoryview(read_untrusted(path, MOST_SEGMENT_BYTES))
        self._number = number
        header = decode_segment_header(self._content)
        if header is not None and header[0] != FORMAT:
            raise CannotResume(f"{path} has segment format {header[0]}, this learner reads {FORMAT}")
        self._header_intact = header is not None
        self.first = header[2] if header is not None else expected_first
        self._checksum = hashlib.sha256()
        self._records = 0

    def facts(self) -> SegmentFacts:
        """What the segment contains."""
        return SegmentFacts(
            self._number, self.first, self._records, len(self._content), self._checksum.hexdigest()
        )

    def __iter__(self) -> Iterator[Record | Damage]:
        """Intact records and damages in the order of the file."""
        content, position = self._content, SEGMENT_HEADER_BYTES
        if not self._header_intact:
            if len(content) < SEGMENT_HEADER_BYTES:
                yield Damage(self._path, 0, len(content), torn=True)
                return
            yield Damage(self._path, 0, SEGMENT_HEADER_BYTES)
        while position < len(content):
            item, position = self._item_at(position)
            yield item

    def _item_at(self, position: int) -> tuple[Record | Damage, int]:
        """The record or damage at `position`, and the position of the next one."""
        header = header_at(self._content, position)
        if header is None:
            following = self._next_header(position + 1)
            end = len(self._content) if following is None else following
            return Damage(self._path, position, end, torn=following is None), end
        start, end = position + HEADER_BYTES, position + HEADER_BYTES + header.length
        if end > len(self._content):
            return Damage(self._path, position, len(self._content), torn=True), len(self._content)
        body = self._content[start:end]
        if zlib.crc32(body) != header.body_checksum:
            return Damage(self._path, position, end, number=header.number), end
        self._checksum.update(self._content[position:start])
        self._records += 1
        return Record(header.kind, header.number, bytes(body)), end

    def _next_header(self, position: int) -> int | None:
        whole = self._content.obj
        assert isinstance(whole, bytes)
        while (position := whole.find(MARKER, position)) >= 0:
            if header_at(self._content, position) is not None:
                return position
            position += 1
        return None
