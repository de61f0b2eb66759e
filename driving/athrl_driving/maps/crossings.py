"""Roads that cross on one level without a junction: the place where they cross is made into one.

Otherwise vehicles would drive through each other there. Files have such crossings where an exporter wrote no
junction, and where a bridge has no height.
"""

import math
from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.chords import CHORD, are_on_one_level, are_one_way, chords_of
from athrl_driving.maps.disjoint_sets import DisjointSets
from athrl_driving.maps.findings import Findings
from athrl_driving.maps.near_pairs import near_pairs, refuse_many
from athrl_driving.maps.opendrive.bounds import MOST_CROSSINGS
from athrl_driving.maps.opendrive.carriageways import Carriageway, LaneSegment
from athrl_driving.maps.overlaps import CLEARANCE, SHARE_OF_WIDTH
from athrl_driving.maps.splitting import split
from athrl_driving.maps.standing_segments import STANDING_LENGTH, predecessors_of

FOUND = "roads cross without a junction: at the crossing one vehicle at a time drives, as in a junction"

_LEAST_ANGLE = math.radians(5.0)
"""Lanes that meet at a smaller angle run beside each other: no crossing, but a drawing that is not exact."""

_BEFORE = 1.0
"""Metres that a vehicle stops before the place where it would be in the other one's way."""

_CUT = 2.0
"""Metres between places where a road is cut, about."""

Floats = NDArray[np.float64]
Links = dict[LaneSegment, list[LaneSegment]]


class _Crossing(NamedTuple):
    """Two segments, where on them they cross (m) and at which angle (rad)."""

    segments: tuple[LaneSegment, LaneSegment]
    places: tuple[float, float]
    angle: float


class FoundCrossing(NamedTuple):
    """A place where two lanes cross, which is part of a junction now."""

    junction: str
    """What its segments have as `junction`."""
    place: str
    roads: tuple[str, str]
    """Their ids."""


class _Stretch(NamedTuple):
    """A part of a segment (m, m) on which a vehicle is in the way at a crossing."""

    begin: float
    end: float
    crossing: int


def make_junctions_of_crossings(carriageways: list[Carriageway]) -> list[FoundCrossing]:
    """Make the parts of ordinary lanes junctions on which they cross each other on one level.

    Return where lanes cross. Raises `ValueError` where too many lanes lie close together or cross.
    """
    segments = [lane for carriageway in carriageways for lane in carriageway.lanes]
    ordinary = [segment for segment in segments if not segment.junction]
    if not ordinary:
        return []
    before = predecessors_of(segments)
    crossings = [
        crossing for crossing in _crossings(ordinary) if not are_one_way(crossing.segments, crossing.places)
    ]
    if not crossings:
        return []
    stretches = _stretches(crossings, before)
    names = _names(crossings, stretches)
    found = [
        FoundCrossing(name, _place(crossing), _roads(crossing))
        for name, crossing in zip(names, crossings, strict=True)
    ]
    parts: list[Carriageway] = []
    for carriageway in carriageways:
        crosses = any(segment in stretches for segment in carriageway.lanes)
        parts += _marked(carriageway, stretches, names) if crosses else [carriageway]
    carriageways[:] = parts
    return found


def note_crossings(findings: Findings, crossings: list[FoundCrossing], driven: set[LaneSegment]) -> None:
    """Note each junction that was made of crossings, by the first of which both roads are driven on there."""
    there = {(segment.junction, segment.carriageway.road.id) for segment in driven}
    noted: set[str] = set()
    for junction, place, roads in crossings:
        if junction not in noted and all((junction, road) in there for road in roads):
            noted.add(junction)
            findings.add(FOUND, place, allowed=True)


def _roads(crossing: _Crossing) -> tuple[str, str]:
    first, second = crossing.segments
    return first.carriageway.road.id, second.carriageway.road.id


def _crossings(segments: list[LaneSegment]) -> Iterator[_Crossing]:
    """Yield where centre lines cross on one level."""
    chords = chords_of(segments)
    middle = chords.points.mean(axis=1)
    for a, b in near_pairs(middle[:, 0], middle[:, 1], CHORD, "parts of lanes"):
        other = chords.segment[a] < chords.segment[b]
        a, b = a[other], b[other]
        for place, share_a, share_b in _meeting(chords.points[a], chords.points[b]):
            first, second = int(a[place]), int(b[place])
            pair = segments[chords.segment[first]], segments[chords.segment[second]]
            places = _along(chords.s[first], share_a), _along(chords.s[second], share_b)
            angle = _angle(pair, places)
            if angle >= _LEAST_ANGLE and are_on_one_level(pair, places):
                yield _Crossing(pair, places, angle)


def _meeting(first: Floats, second: Floats) -> Iterator[tuple[int, float, float]]:
    """Yield which pairs of chords [n, 2, 2] meet, and at which share of each.

    Raises `ValueError` where too many do.
    """
    along, beside = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0]
    between = second[:, 0] - first[:, 0]
    area = _cross(along, beside)
    level = np.abs(area) > 1e-9
    area = np.where(level, area, 1.0)
    share_a, share_b = _cross(between, beside) / area, _cross(between, along) / area
    meets = level & (share_a >= 0.0) & (share_a < 1.0) & (share_b >= 0.0) & (share_b < 1.0)
    refuse_many(int(meets.sum()), MOST_CROSSINGS, "places where lanes cross outside junctions")
    for place in np.flatnonzero(meets).tolist():
        yield place, float(share_a[place]), float(share_b[place])


def _cross(first: Floats, second: Floats) -> Floats:
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def _along(ends: Floats, share: float) -> float:
    return float(ends[0] + share * (ends[1] - ends[0]))


def _angle(pair: tuple[LaneSegment, LaneSegment], places: tuple[float, float]) -> float:
    """Return the angle between two lanes at a crossing, 0 to a right one."""
    first, second = (segment.at(s)[2] for segment, s in zip(pair, places, strict=True))
    return math.asin(min(1.0, abs(math.sin(first - second))))


def _stretches(crossings: list[_Crossing], before: Links) -> dict[LaneSegment, list[_Stretch]]:
    """Return by segment on which parts of it a vehicle is in the way of another at a crossing."""
    found: dict[LaneSegment, list[_Stretch]] = defaultdict(list)
    for number, crossing in enumerate(crossings):
        wide = SHARE_OF_WIDTH * sum(segment.width for segment in crossing.segments)
        reach = min(CLEARANCE, wide) / math.sin(crossing.angle) + _BEFORE
        for segment, s in zip(crossing.segments, crossing.places, strict=True):
            for covered, begin, end in _covered(segment, s - reach, s + reach, before):
                found[covered].append(_Stretch(begin, end, number))
    return {segment: sorted(own) for segment, own in found.items()}


def _covered(
    segment: LaneSegment, begin: float, end: float, before: Links
) -> Iterator[tuple[LaneSegment, float, float]]:
    """Yield a stretch of a segment, and what of it lies on ordinary ones before and behind it."""
    yield segment, max(begin, 0.0), min(end, segment.length)
    earlier, missing = segment, -begin
    while missing > 0.0 and len(before[earlier]) == 1 and not before[earlier][0].junction:
        earlier = before[earlier][0]
        yield earlier, max(earlier.length - missing, 0.0), earlier.length
        missing -= earlier.length
    later, missing = segment, end - segment.length
    while missing > 0.0 and len(later.successors) == 1 and not later.successors[0].junction:
        later = later.successors[0]
        yield later, 0.0, min(missing, later.length)
        missing -= later.length


def _names(crossings: list[_Crossing], stretches: dict[LaneSegment, list[_Stretch]]) -> list[str]:
    """Return the junction of each crossing; those between which no vehicle could stand are one."""
    joined = DisjointSets(range(len(crossings)))
    for own in stretches.values():
        end, latest = -math.inf, own[0].crossing
        for stretch in own:
            if stretch.begin - end < STANDING_LENGTH:
                joined.join(latest, stretch.crossing)
            if stretch.end > end:
                end, latest = stretch.end, stretch.crossing
    names = {root: f"crossing of {_place(crossings[root])}" for root in joined.sets()}
    return [names[joined.root(number)] for number in range(len(crossings))]


def _place(crossing: _Crossing) -> str:
    """Say where on the two roads a crossing is."""
    places = []
    for segment, s in zip(crossing.segments, crossing.places, strict=True):
        carriageway, share = segment.carriageway, s / segment.length
        share = share if carriageway.forward else 1.0 - share
        station = carriageway.start + share * (carriageway.end - carriageway.start)
        places.append(f"road {carriageway.road.id} at {station:.0f} m")
    return " and ".join(places)


def _marked(
    carriageway: Carriageway, stretches: dict[LaneSegment, list[_Stretch]], names: list[str]
) -> list[Carriageway]:
    """Cut a carriageway into parts, make junctions of their lanes where those cross others; return them."""
    longest = max(segment.length for segment in carriageway.lanes)
    steps = max(1, int(longest / _CUT))
    # By lane, in the order of the carriageway: the crossing of each step, or none.
    marks: list[list[str]] = []
    for segment in carriageway.lanes:
        own = [""] * steps
        for begin, end, crossing in stretches.get(segment, []):
            first = int(steps * begin / segment.length)
            last = min(max(math.ceil(steps * end / segment.length), first + 1), steps)
            own[first:last] = [names[crossing]] * (last - first)
        marks.append(own)
    columns = list(zip(*marks, strict=True))
    done, parts = 0, [carriageway]
    for step in range(1, steps + 1):
        if step < steps and columns[step] == columns[step - 1]:
            continue
        part = parts[-1]
        if step < steps:
            parts.append(split(part, (step - done) / (steps - done)))
        for segment, name in zip(part.lanes, columns[step - 1], strict=True):
            segment.junction = segment.junction or name
        done = step
    return parts
