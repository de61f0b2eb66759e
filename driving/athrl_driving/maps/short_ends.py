"""Roads that leave the map close behind a junction, or enter it close before one, are made long enough.

Maps are cut out of larger ones, often right behind a junction. Beyond the edge the road goes on in truth; as
the file has it, no vehicle could leave the junction there, as none may stand on so short a road.
"""

from collections.abc import Callable

from athrl_driving.maps.findings import Findings
from athrl_driving.maps.opendrive.carriageways import Carriageway, LaneSegment
from athrl_driving.maps.standing_segments import STANDING_LENGTH, all_segments, predecessors_of

FOUND = "a road that ends at the map's edge close to a junction was prolonged to be of use"

_MOST_TURN = 1.5
"""Radians: a lane that bends more is not prolonged."""
_ROUNDING = 1e-3

Links = dict[LaneSegment, list[LaneSegment]]


def prolong_short_ends(findings: Findings, carriageways: list[Carriageway]) -> None:
    """Prolong roads at the map's edge to `STANDING_LENGTH`, straight on or along their arc; note each."""
    segments = all_segments(carriageways)
    before = predecessors_of(segments)
    after = {segment: segment.successors for segment in segments}
    for carriageway in carriageways:
        for onwards, backwards, prolong in ((after, before, _end_later), (before, after, _start_earlier)):
            metres = _missing(carriageway.lanes, onwards, backwards)
            if metres > 0.0 and all(_bends_little(segment, metres) for segment in carriageway.lanes):
                _prolong(findings, carriageway, metres, prolong)


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


def _prolong(
    findings: Findings,
    carriageway: Carriageway,
    metres: float,
    prolong: Callable[[LaneSegment, float], None],
) -> None:
    for segment in carriageway.lanes:
        prolong(segment, metres + _ROUNDING)
        segment.prolonged = True
    findings.add(FOUND, f"road {carriageway.road.id}", metres, allowed=True)


def _end_later(segment: LaneSegment, metres: float) -> None:
    segment.end_elevation += _grade(segment) * metres
    segment.length += metres


def _start_earlier(segment: LaneSegment, metres: float) -> None:
    segment.elevation -= _grade(segment) * metres
    segment.x, segment.y, segment.heading = segment.at(-metres)
    segment.length += metres


def _grade(segment: LaneSegment) -> float:
    return (segment.end_elevation - segment.elevation) / segment.length
