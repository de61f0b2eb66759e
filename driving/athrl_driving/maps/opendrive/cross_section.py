"""Where a section's lanes lie beside the reference line, and how wide they are."""

import itertools
import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.opendrive.bounds import (
    FARTHEST_BESIDE,
    LARGEST_NEGATIVE_WIDTH,
    LARGEST_STEP,
    SAME_PLACE,
    STEP,
)
from athrl_driving.maps.opendrive.model import (
    Cubic,
    Geometry,
    Lane,
    LaneMark,
    LaneSection,
    OpenDrive,
    Road,
    SpeedLimit,
    record_at,
)

Floats = NDArray[np.float64]

NARROWEST = 2.2
"""Metres: where a lane opens or closes, what is narrower than this is no lane to drive on."""

_NO_MARK = LaneMark(-math.inf, increase=True, decrease=True)

_LEAST = 0.5
"""Metres: what is nowhere wider than this is no lane, whatever it is called."""
_ROUNDED_WIDTH = -1e-3
_NARROW_SHARE = 0.7


@dataclass(frozen=True, slots=True)
class LaneBand:
    """A driving lane between two stations: its centre's `t` and its width at the asked stations."""

    lane: Lane
    centre: Floats
    width: Floats
    constant: bool


def bands_at(content: OpenDrive, road: Road, section: LaneSection, stations: Floats) -> dict[int, LaneBand]:
    """Return the driving lanes of a section at stations [n] between two neighbouring `breakpoints`."""
    middle = 0.5 * (float(stations[0]) + float(stations[-1]))
    offset = record_at(road.offsets, middle)
    shift, shift_constant = _value(offset, stations)
    bands: dict[int, LaneBand] = {}
    for side in (1, -1):
        inner, constant = np.zeros_like(stations), shift_constant
        for lane in _outwards(section, side):
            width, own_constant = _value(record_at(lane.widths, middle) or lane.widths[0], stations)
            if float(width.min()) < _ROUNDED_WIDTH:
                width = _at_least_zero(content, road, lane, width, stations)
            constant = constant and own_constant
            farthest = float(np.abs(shift + side * (inner + width)).max())
            if not farthest <= FARTHEST_BESIDE:
                message = (
                    f"it lies {farthest:,.0f} m beside the road, at most {FARTHEST_BESIDE:,.0f} m may be"
                )
                raise content.error(road.id, lane.id, lane.line, message)
            if lane.drives:
                bands[lane.id] = LaneBand(lane, shift + side * (inner + 0.5 * width), width, constant)
            inner = inner + width
    return bands


def _at_least_zero(content: OpenDrive, road: Road, lane: Lane, width: Floats, stations: Floats) -> Floats:
    """Return a width that is a little below 0 somewhere as 0 there. Raises `MapError`: it is far below."""
    narrowest = float(width.min())
    if narrowest < -LARGEST_NEGATIVE_WIDTH:
        at = float(stations[int(np.argmin(width))])
        message = f"its width is {narrowest:.3f} m at s = {at:.2f} m, it must not be negative"
        raise content.error(road.id, lane.id, lane.line, message)
    content.note("a width below 0 was taken as 0", road.id, lane.id, lane.line, -narrowest)
    return np.maximum(width, 0.0)


def breakpoints(content: OpenDrive, road: Road, section: LaneSection) -> list[float]:
    """Return a section's ends and the stations between where the formula of a driving lane changes."""
    cuts: set[float] = set()
    for starts in (road.geometries, road.offsets, road.speeds):
        cuts.update(_starts_within(starts, section))
    for side in (1, -1):
        records: list[Cubic] = []
        for lane in _outwards(section, side):
            records += lane.widths
            if lane.drives:
                cuts.update(record.s for record in records)
                cuts.update(limit.s for limit in lane.speeds)
                cuts.update(_changes_of_permission(lane))
                cuts.update(_narrow_ends(lane, section))
    # What is as good as a section's end is that end, where the next section begins: there they are linked.
    inside = sorted(s for s in cuts if section.s < s < section.end - SAME_PLACE)
    distinct = [section.s]
    for s in inside:
        if s - distinct[-1] > SAME_PLACE:
            distinct.append(s)
    return [*distinct, section.end] if section.end - section.s > SAME_PLACE else distinct


def _changes_of_permission(lane: Lane) -> list[float]:
    """Return where a lane's marks begin to allow, or to forbid, what was not so before; at first all is."""
    return [
        mark.s
        for before, mark in itertools.pairwise([_NO_MARK, *lane.marks])
        if (mark.increase, mark.decrease) != (before.increase, before.decrease)
    ]


def _starts_within(records: Sequence[Geometry | Cubic | SpeedLimit], section: LaneSection) -> list[float]:
    """Return where the records begin that begin in the section."""
    first = bisect_left(records, section.s, key=lambda record: record.s)
    last = bisect_right(records, section.end, key=lambda record: record.s)
    return [record.s for record in records[first:last]]


def is_too_narrow(lane: Lane, section: LaneSection, width: float) -> bool:
    """Tell whether a part of a lane with this mean width belongs to where the lane opens or closes."""
    return width < _narrow_limit(lane, section)


def speed_limit_at(road: Road, lane: Lane, s: float, default: float) -> float:
    """Return the posted limit (m/s): the lane's, else the road's, else `default`."""
    for records in (lane.speeds, road.speeds):
        place = bisect_right(records, s + 1e-6, key=lambda record: record.s)
        limit = records[place - 1].limit if place else None
        if limit is not None:
            return limit
    return default


def elevation_at(road: Road, s: float) -> float:
    """Return the reference line's height (m); before the first record it is that record's first height."""
    record = record_at(road.elevations, s)
    if record is not None:
        return record.at(s)
    return road.elevations[0].a if road.elevations else 0.0


def check_heights(content: OpenDrive, road: Road) -> None:
    """Note where a road's height steps; what stands for it later is a slope. Raises `MapError`: too high."""
    # Of two that start at one place the first holds nowhere.
    holding = [
        record
        for record, following in itertools.zip_longest(road.elevations, road.elevations[1:])
        if following is None or following.s > record.s
    ]
    for record, following in itertools.pairwise(holding):
        step = abs(following.a - record.at(following.s))
        if step > LARGEST_STEP:
            place = f"at s = {following.s:.2f} m, at most {LARGEST_STEP} m may be"
            message = f"its height steps by {step:.3f} m {place}"
            raise content.error(road.id, None, following.line, message)
        if step > STEP:
            content.note("a step in a road's height was bridged", road.id, None, following.line, step)


def climbs_evenly(road: Road, start: float, end: float, tolerance: float) -> bool:
    """Tell whether the height between two stations is within `tolerance` (m) of a straight slope."""
    if len(road.elevations) < 2 and all(record.is_constant for record in road.elevations):
        return True
    first, last = elevation_at(road, start), elevation_at(road, end)
    shares = np.linspace(0.0, 1.0, max(5, int((end - start) / 5.0)))[1:-1]
    heights = _elevations(road, start + shares * (end - start))
    return bool((np.abs(heights - first - shares * (last - first)) <= tolerance).all())


def _elevations(road: Road, stations: Floats) -> Floats:
    """Return the heights (m) at ascending stations [n], as `elevation_at` does."""
    begin = max(bisect_right(road.elevations, stations[0] + 1e-9, key=lambda record: record.s) - 1, 0)
    end = bisect_right(road.elevations, stations[-1] + 1e-9, key=lambda record: record.s)
    records = road.elevations[begin : max(end, begin + 1)]
    terms = np.array([(record.s, record.a, record.b, record.c, record.d) for record in records])
    place = np.searchsorted(terms[:, 0], stations + 1e-9, side="right") - 1
    s, a, b, c, d = terms[np.maximum(place, 0)].T
    ds = np.where(place < 0, 0.0, stations - s)
    return np.asarray(a + ds * (b + ds * (c + ds * d)))


def _outwards(section: LaneSection, side: int) -> list[Lane]:
    """Return the lanes of a side (1 left, -1 right) from the centre to its outermost driving lane."""
    lanes = [section.lanes[lane] for lane in sorted(section.lanes, key=abs) if lane * side > 0]
    while lanes and not lanes[-1].drives:
        lanes.pop()
    return lanes


def _value(record: Cubic | None, stations: Floats) -> tuple[Floats, bool]:
    if record is None:
        return np.zeros_like(stations), True
    if record.is_constant:
        return np.full_like(stations, record.a), True
    ds = stations - record.s
    return record.a + ds * (record.b + ds * (record.c + ds * record.d)), False


def _narrow_limit(lane: Lane, section: LaneSection) -> float:
    if len(lane.widths) == 1 and lane.widths[0].is_constant:
        return _LEAST
    stations = np.linspace(section.s, section.end, 17)
    widest = max(_width_at(lane, float(s)) for s in stations)
    return min(NARROWEST, _NARROW_SHARE * widest)


def _width_at(lane: Lane, s: float) -> float:
    record = record_at(lane.widths, s) or lane.widths[0]
    return record.at(s)


def _narrow_ends(lane: Lane, section: LaneSection) -> list[float]:
    """Return the stations where a lane becomes wide or narrow enough, found by bisection."""
    if len(lane.widths) == 1 and lane.widths[0].is_constant:
        return []
    limit = _narrow_limit(lane, section)
    stations = [float(s) for s in np.linspace(section.s, section.end, 65)]
    found = []
    for low, high in itertools.pairwise(stations):
        below = _width_at(lane, low) < limit
        if below == (_width_at(lane, high) < limit):
            continue
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if (_width_at(lane, middle) < limit) == below else (low, middle)
        found.append(high)
    return found
