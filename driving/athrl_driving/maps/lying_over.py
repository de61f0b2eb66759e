"""Lanes that lie on each other along the road, on one level and without a junction: told, not mended.

Which of them is meant cannot be known: a road that is in the file twice, or a ramp that is not linked to its
motorway. Vehicles on them drive through each other.
"""

import math
from collections import defaultdict

import numpy as np

from athrl_driving.maps.chords import CHORD, Floats, Integers, are_on_one_level, are_one_way, chords_of
from athrl_driving.maps.findings import Findings
from athrl_driving.maps.near_pairs import near_pairs, refuse_many
from athrl_driving.maps.opendrive.bounds import MOST_LYING_OVER
from athrl_driving.maps.opendrive.carriageways import LaneSegment

FOUND = "two roads lie on each other without a junction: vehicles drive through each other there"

_OVER = 1.8
"""Metres between centre lines, below which vehicles on them touch."""

_MEET = 0.1
"""Metres: by so little two parts of lanes overlap that meet."""

_LEAST = 10.0
"""Metres of lane that are told of: less is where roads meet."""

_ONE_PLACE = 25.0
"""Metres along one road, below which its lanes are beside each other and not over each other."""

_ALONG = math.sin(math.radians(10.0))


def note_lanes_lying_over(findings: Findings, segments: list[LaneSegment]) -> None:
    """Note each pair of roads of which ordinary lanes lie on each other, and for how many metres of lanes.

    Raises `ValueError` where too many lanes lie on each other.
    """
    segments = [segment for segment in segments if not segment.junction]
    if not segments:
        return
    chords = chords_of(segments)
    middle, s = chords.points.mean(axis=1), chords.s.mean(axis=1)
    length = chords.s[:, 1] - chords.s[:, 0]
    numbers: dict[str, int] = {}
    road_of = [numbers.setdefault(segment.carriageway.road.id, len(numbers)) for segment in segments]
    road = np.array(road_of)[chords.segment]
    station = _stations(segments, chords.segment, s)
    lying = 0
    found: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for a, b in near_pairs(middle[:, 0], middle[:, 1], CHORD, "parts of lanes"):
        along = chords.points[a, 1] - chords.points[a, 0]
        between = middle[b] - middle[a]
        beside = np.abs(along[:, 0] * between[:, 1] - along[:, 1] * between[:, 0])
        near = (beside < _OVER * length[a]) & (chords.segment[a] < chords.segment[b])
        near &= np.hypot(between[:, 0], between[:, 1]) < CHORD
        # Parts that only meet end to end, as those of roads in line, do not lie on each other.
        onward = np.abs((along * between).sum(axis=1))
        near &= onward < length[a] * (0.5 * (length[a] + length[b]) - _MEET)
        near &= (road[a] != road[b]) | (np.abs(station[a] - station[b]) > _ONE_PLACE)
        lying += int(near.sum())
        refuse_many(lying, MOST_LYING_OVER, "pairs of parts of lanes lie on each other")
        for first, second in zip(a[near].tolist(), b[near].tolist(), strict=True):
            found[int(chords.segment[first]), int(chords.segment[second])].append((first, second))
    metres: dict[str, float] = defaultdict(float)
    for (first, second), pairs in found.items():
        pair = segments[first], segments[second]
        places = float(s[pairs[0][0]]), float(s[pairs[0][1]])
        turned = abs(math.sin(pair[0].at(places[0])[2] - pair[1].at(places[1])[2]))
        roads = [segment.carriageway.road.id for segment in pair]
        if turned > _ALONG or are_one_way(pair, places):
            continue
        if are_on_one_level(pair, places):
            own = {chord for chord, _ in pairs}
            other = "itself" if roads[0] == roads[1] else f"road {roads[1]}"
            metres[f"road {roads[0]} and {other}"] += float(length[list(own)].sum())
    for place, total in metres.items():
        if total >= _LEAST:
            findings.add(FOUND, f"{place}, all lanes together", total, allowed=True)


def _stations(segments: list[LaneSegment], number: Integers, s: Floats) -> Floats:
    """Return the stations on their roads of places `s` metres along the segments with these numbers."""
    rows = [(each.carriageway.start, each.carriageway.end, each.length) for each in segments]
    start, end, length = np.array(rows)[number].T
    forward = np.array([segment.carriageway.forward for segment in segments])[number]
    share = s / length
    return np.asarray(start + np.where(forward, share, 1.0 - share) * (end - start))
