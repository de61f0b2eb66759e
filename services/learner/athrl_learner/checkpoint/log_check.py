"""Whether the log still holds the segments that a checkpoint names."""

from __future__ import annotations

import hashlib
from pathlib import Path

from athrl_spaces.untrusted import open_untrusted, parser_errors

from athrl_learner.errors import DamagedCheckpoint, SegmentsMissing
from athrl_learner.log import LogPosition, SegmentFacts, numbered_segments
from athrl_learner.log.records import HEADER_BYTES, header_at
from athrl_learner.log.segments import MOST_SEGMENT_BYTES, SEGMENT_HEADER_BYTES, decode_segment_header


def require_own_segments(checkpoint: Path, position: LogPosition, experience: Path) -> None:
    """Refuse a checkpoint whose replay is not in the log.

    A part of the segments is enough: the rest of the experience is lost, and is counted when it is restored.

    Raises:
        SegmentsMissing: none of the segments that it names is there.
        DamagedCheckpoint: the newest of them is of another run.
    """
    paths = numbered_segments(experience)
    there = [facts for facts in position.segments if facts.number in paths]
    if position.segments and not there:
        first, last = position.segments[0].number, position.segments[-1].number
        named = f"segment {last}" if first == last else f"segments {first} to {last}"
        raise SegmentsMissing(f"the replay of checkpoint {checkpoint} is gone: {experience} has no {named}")
    if not there:
        return
    newest = paths[there[-1].number]
    if _is_another(newest, there[-1]):
        raise DamagedCheckpoint(
            f"checkpoint {checkpoint} is of another run: {newest} is not the segment that it names"
        )


def _is_another(path: Path, facts: SegmentFacts) -> bool:
    """Whether the headers of a segment are intact and are not those that the checkpoint saw.

    The headers hold the checksums of the bodies. One that is damaged proves nothing.
    """
    with (
        parser_errors(lambda reason: DamagedCheckpoint(f"segment {path}: {reason}"), OSError),
        open_untrusted(path, MOST_SEGMENT_BYTES) as file,
    ):
        header = decode_segment_header(memoryview(file.read(SEGMENT_HEADER_BYTES)))
        if header is None:
            return False
        checksum = hashlib.sha256()
        for _ in range(facts.records):
            raw = file.read(HEADER_BYTES)
            record = header_at(memoryview(raw), 0)
            if record is None:
                return False
            checksum.update(raw)
            file.seek(record.length, 1)
        return header[1:] != (facts.number, facts.first) or checksum.hexdigest() != facts.checksum
