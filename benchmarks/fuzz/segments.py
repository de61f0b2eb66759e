"""Segments of the experience log, as the learner of a run that is resumed reads them."""

from __future__ import annotations

import json
import random
import struct
import zlib
from pathlib import Path

from athrl_learner.checkpoint.log_check import require_own_segments
from athrl_learner.errors import LearnerError
from athrl_learner.log.records import HEADER_BYTES, MARKER, Kind, encode_header

from benchmarks.fuzz import mutations
from benchmarks.fuzz.frame import Parser, file_parser
from benchmarks.fuzz.small_run import SmallRun

_FIELDS = "<4sB3xIIQ"
_LARGEST = (2**8 - 1, 2**32 - 1, 2**32 - 1, 2**64 - 1)
"""Of kind, length, checksum and number."""


def segment(folder: Path) -> Parser:
    """Return the parser of a segment: the first, which the checkpoint names, or the last, which is later."""
    run = SmallRun(folder)
    paths, content = list(run.segments), run.newest()
    path = folder / "segment"
    turn = iter(range(2**62))

    def read(path: Path) -> None:
        run.repair()
        paths[-1 if next(turn) % 2 else 0].write_bytes(path.read_bytes())
        require_own_segments(run.checkpoint, content.log, path.parent / "experience")
        run.restore(content)

    ways = [*mutations.BYTES, _changed_header, _changed_header, _changed_refusal, _changed_body]
    return file_parser([run.segments[paths[0]], run.segments[paths[-1]]], ways, path, read, LearnerError)


def _changed_header(chance: random.Random, content: bytes) -> bytes:
    """Return the segment with a record's header of odd numbers, whose checksum is right."""
    place = chance.choice(_records(content))
    fields = list(struct.unpack_from(_FIELDS, content, place))
    which = chance.randrange(4)
    largest = _LARGEST[which]
    fields[1 + which] = chance.choice([0, 1, 2, largest // 2, largest // 2 + 1, largest - 1, largest])
    header = struct.pack(_FIELDS, *fields)
    return content[:place] + header + struct.pack("<I", zlib.crc32(header)) + content[place + HEADER_BYTES :]


def _changed_body(chance: random.Random, content: bytes) -> bytes:
    """Return the segment with another body, whose checksum is right."""
    place = chance.choice(_records(content))
    _, kind, length, _, number = struct.unpack_from(_FIELDS, content, place)
    start, end = place + HEADER_BYTES, place + HEADER_BYTES + length
    body = chance.choice(mutations.BYTES)(chance, content[start:end])
    return content[:place] + encode_header(Kind(kind), number, body) + body + content[end:]


def _changed_refusal(chance: random.Random, content: bytes) -> bytes:
    """Return the segment with a refused chunk of odd values at its end."""
    values = {"actor": "actor-1", "incarnation": 1, "sequence": 18}
    body = chance.choice(
        [json.dumps(mutations.changed_document(chance, values)).encode(), b"[" * 50_000, b"\xff", b"null"]
    )
    number = struct.unpack_from(_FIELDS, content, _records(content)[-1])[4] + 1
    return content + encode_header(Kind.REFUSAL, number, body) + body


def _records(content: bytes) -> list[int]:
    """Where the records of an intact segment begin, more or less: a body may have the marker inside."""
    places, place = [], -1
    while (place := content.find(MARKER, place + 1)) >= 0:
        places.append(place)
    return places
