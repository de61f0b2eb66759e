"""Roads that leave the map close behind a junction, or enter it close before one, are made long enough.

Maps are cut out of larger ones, often right behind a junction. Beyond the edge the road goes on in truth; as
the file has it, no vehicle could leave the junction there, as none may stand on so short a road.
"""

from collections.abc import Iterable

from athrl_driving.maps.findings import Findings
from athrl_driving.maps.opendrive.carriageways import Carriageway, LaneSegment
from athrl_driving.maps.standing_segments import STANDING_LENGTH, all_segments, predecessors_of

FOUND = "a road that ends at the map's edge close to a junction was prolonged to be of use"

_MOST_TURN = 1.5
"""Radians: a lane that bends more is not prolonged."""
_ROUNDING = 1e-3

Links = dict[LaneSegment, list[LaneSegment]]


def prolong_short_ends(carriageways: list[Carriageway]) -> None:
    """Prolong roads at the map's edge to `STANDING_LENGTH`, straight on or along their arc."""
    segments = all_segments(carriageways)
    before = predecessors_of(segments)
    after = {segment: segment.successors for segment in segments}
    for carriageway in carriageways:
        for onwards, backwards, at_end in ((after, before, True), (before, after, False)):
            metres = _missing(carriageway.lanes, onwards, backwards)
            if metres > 0.0 and all(_bends_little(segment, metres) for segment in carriageway.lanes):
                for segment in carriageway.lanes:
                    _lengthen(segment, metres + _ROUNDING, at_end)


def _missing(lanes: list[LaneSegment], onwards: Links, backwards: Links) -> float:
    """Return by how many metres lanes have to be longer where nothing follows any of them, else 0."""
    if any(segment.junction or onwards.get(segment) for segment in lanes):
        return 0.0
    return max(STANDING_LENGTH - _length_to_junction(segment, onwards, backwards) for segment in lanes)


def _length_to_junction(segment: LaneSegment, onwards: Links, backwards: Links) -> float:
    """Return the metres from the map's edge to a junction; `STANDING_LENGTH` where none is so near."""
    length = segment.length
    while length < STANDING_LENGTH:
        others = backwards.get(segment, [])
        if not others:
            return STANDING_LENGTH  # a road by itself, not at a junction
        if len(others) > 1 or others[0].junction or len(onwards[others[0]]) > 1:
            return length
        segment = others[0]
        length += segment.length
    return STANDING_LENGTH


def _bends_little(segment: LaneSegment, metres: float) -> bool:
    return abs(segment.curvature) * (segment.length + metres) < _MOST_TURN


def settle_short_ends(findings: Findings, kept: Iterable[LaneSegment], lost: Iterable[LaneSegment]) -> None:
    """Note the lanes that are driven on because they were prolonged, and make the others as they were."""
    for segment in kept:
        if segment.prolonged:
            place = f"road {segment.carriageway.road.id}, lane {segment.lane.id}"
            findings.add(FOUND, place, abs(segment.prolonged), allowed=True)
    for segment in lost:
        if segment.prolonged:
            _lengthen(segment, -abs(segment.prolonged), at_end=segment.prolonged > 0.0)


def _lengthen(segment: LaneSegment, metres: float, at_end: bool) -> None:
    """Make a lane longer by some metres, below 0 shorter, at its end or at its start."""
    rise = (segment.end_elevation - segment.elevation) / segment.length * metres
    if at_end:
        segment.end_elevation += rise
    else:
        segment.elevation -= rise
        segment.x, segment.y, segment.heading = segment.at(-metres)
    segment.length += metres
    segment.prolonged += metres if at_end else -metres
