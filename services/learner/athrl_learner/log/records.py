"""Records as bytes: a marker, length, number and checksums around a body.

    marker   4 bytes
    kind     1 byte, 3 bytes of padding
    length   uint32, of the body
    checksum uint32, CRC-32 of the body
    number   uint64, of the record in the run: 0, 1, 2, ...
    checksum uint32, CRC-32 of the 24 bytes before it
    body

The header has its own checksum, so its length can be trusted: a damaged body is skipped, and after a damaged
header reading continues at the next marker with an intact header.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

MARKER = b"\x93ath"
_FIELDS = struct.Struct("<4sB3xIIQ")
_CHECKSUM = struct.Struct("<I")
HEADER_BYTES = _FIELDS.size + _CHECKSUM.size


class Kind(IntEnum):
    """What a record's body is."""

    CHUNK = 1  # an accepted chunk, the message as it was received
    REFUSAL = 2  # JSON: actor, incarnation and sequence of a chunk that was refused permanently


@dataclass(frozen=True)
class RecordHeader:
    """The header before a body."""

    kind: int
    length: int
    body_checksum: int
    number: int


@dataclass(frozen=True)
class Record:
    """An intact record.

    Attributes:
        kind: what its body is; may be a number that this release does not know.
        number: of the record in the run, from 0.
        body: the appended bytes.
    """

    kind: int
    number: int
    body: bytes


def encode_header(kind: Kind, number: int, body: bytes) -> bytes:
    """Return the header for a body."""
    fields = _FIELDS.pack(MARKER, kind, len(body), zlib.crc32(body), number)
    return fields + _CHECKSUM.pack(zlib.crc32(fields))


def header_at(content: memoryview, position: int) -> RecordHeader | None:
    """The header at `position`, or None if there is no intact one."""
    raw = content[position : position + HEADER_BYTES]
    if len(raw) < HEADER_BYTES or zlib.crc32(raw[: _FIELDS.size]) != _CHECKSUM.unpack(raw[_FIELDS.size :])[0]:
        return None
    marker, kind, length, checksum, number = _FIELDS.unpack(raw[: _FIELDS.size])
    return RecordHeader(kind, length, checksum, number) if marker == MARKER and number < 2**63 else None
