"""A road's lanes as carriageways: all lanes of one direction between two stations, each a line or an arc.

Everything that leaves this module is in the towns' frame: y grows to the right of x and headings grow
clockwise, as in highway-env. A carriageway's lanes are those of one driving direction, from left to right.
"""

import itertools
import math
from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from athrl_driving.maps.opendrive.cross_section import (
    LaneBand,
    bands_at,
    breakpoints,
    check_heights,
    climbs_evenly,
    elevation_at,
    is_too_narrow,
    speed_limit_at,
)
from athrl_driving.maps.opendrive.fitting import Fit, Fitted, exact_fits, fits, forced_fits
from athrl_driving.maps.opendrive.model import Lane, LaneSection, OpenDrive, Road
from athrl_driving.maps.opendrive.reference_line import (
    Floats,
    close_reference_line,
    curvature_of,
    geometry_at,
)

DEFAULT_LIMIT = 50.0 / 3.6
"""m/s, where the file has no speed limit."""

ELEVATION_TOLERANCE = 0.25
_LONGEST_FIT = 20.0
_SHORTEST_FIT = 0.02
_SAMPLES = 9


@dataclass(slots=True, eq=False)
class LaneSegment:
    """One lane of a carriageway, in driving direction: start (m, m, rad), curvature (1/m), length (m)."""

    lane: Lane
    keys: list[tuple[int, int]]
    """The (section, lane id) pairs that it covers, in driving order."""
    x: float
    y: float
    heading: float
    curvature: float
    length: float
    width: float
    limit: float
    elevation: float
    end_elevation: float
    successors: list["LaneSegment"] = field(default_factory=list, repr=False)
    may_left: bool = False
    may_right: bool = False
    junction: str = ""
    """The junction that it leads through; empty on ordinary road."""
    prolonged: float = 0.0
    """Metres by which it is longer than in the file: at its end, or at its start where below 0."""
    carriageway: "Carriageway" = field(init=False, repr=False)

    def at(self, s: float) -> tuple[float, float, float]:
        """Return (x, y, heading) at `s` metres from the start; also before it and beyond the end."""
        heading = self.heading + self.curvature * s
        if self.curvature == 0.0:
            return self.x + s * math.cos(heading), self.y + s * math.sin(heading), heading
        x = self.x + (math.sin(heading) - math.sin(self.heading)) / self.curvature
        y = self.y - (math.cos(heading) - math.cos(self.heading)) / self.curvature
        return x, y, heading


@dataclass(slots=True, eq=False)
class Carriageway:
    """The lanes of one direction between the stations `start` < `end` of a road."""

    road: Road
    forward: bool
    start: float
    end: float
    lanes: list[LaneSegment]


def carriageways_of(content: OpenDrive, road: Road) -> list[Carriageway]:
    """Return a road's carriageways: first those along growing stations; all in driving order."""
    close_reference_line(content, road)
    check_heights(content, road)
    carriageways: list[Carriageway] = []
    cuts = [breakpoints(content, road, section) for section in road.sections]
    content.begin_road(road, sum(map(len, cuts)))
    for number, section in enumerate(road.sections):
        for start, end in itertools.pairwise(cuts[number]):
            carriageways += _interval(content, road, number, section, start, end)
    forward = [carriageway for carriageway in carriageways if carriageway.forward]
    return forward + [carriageway for carriageway in reversed(carriageways) if not carriageway.forward]


def _interval(
    content: OpenDrive, road: Road, number: int, section: LaneSection, start: float, end: float
) -> list[Carriageway]:
    """Return the carriageways between two breakpoints; halved until every lane is a line or an arc."""
    content.count_piece(road, len(section.lanes))
    stations = np.linspace(start, end, _SAMPLES)
    bands = bands_at(content, road, section, stations)
    if not bands:
        return []
    fitted = _fitted(content, road, bands, stations)
    if fitted is None:
        middle = 0.5 * (start + end)
        first = _interval(content, road, number, section, start, middle)
        return first + _interval(content, road, number, section, middle, end)
    for band in fitted.inside:
        content.note(
            "a lane was left out where it lies beyond the centre of its curve",
            road.id,
            band.lane.id,
            band.lane.line,
        )
    return [
        carriageway
        for forward in (True, False)
        if (carriageway := _carriageway(road, number, section, start, end, forward, fitted.lanes)) is not None
    ]


def _fitted(content: OpenDrive, road: Road, bands: dict[int, LaneBand], stations: Floats) -> Fitted | None:
    """Return the lanes as lines and arcs, or None where the piece has to be divided."""
    start, end = float(stations[0]), float(stations[-1])
    divisible = end - start >= _SHORTEST_FIT
    if not climbs_evenly(road, start, end, ELEVATION_TOLERANCE):
        if divisible:
            return None
        message = f"its height changes too fast at s = {0.5 * (start + end):.2f} m"
        raise content.error(road.id, None, road.line, message)
    curvature = curvature_of(geometry_at(road, 0.5 * (start + end)))
    if curvature is not None and all(band.constant for band in bands.values()):
        turns = abs(curvature) * (end - start)
        return exact_fits(road, bands, start, end) if turns < 2.0 or not divisible else None
    fitted = fits(road, bands, stations) if end - start <= _LONGEST_FIT else None
    return fitted if fitted is not None or divisible else forced_fits(content, road, bands, stations)


def _carriageway(
    road: Road,
    number: int,
    section: LaneSection,
    start: float,
    end: float,
    forward: bool,
    fitted: list[tuple[LaneBand, Fit]],
) -> Carriageway | None:
    lanes: list[tuple[float, LaneSegment]] = []
    middle, first, last = 0.5 * (start + end), elevation_at(road, start), elevation_at(road, end)
    for band, fit in fitted:
        lane, width = band.lane, _mean(band, band.width)
        if road.drives_forward(lane) != forward or is_too_narrow(lane, section, width):
            continue
        segment = LaneSegment(
            lane=lane,
            keys=[(number, lane.id)],
            x=fit.x,
            y=-fit.y,
            heading=-fit.heading,
            curvature=-fit.curvature if fit.curvature != 0.0 else 0.0,
            length=fit.length,
            width=width,
            limit=speed_limit_at(road, lane, middle, DEFAULT_LIMIT),
            elevation=first,
            end_elevation=last,
            junction=road.junction if road.in_junction else "",
        )
        lanes.append((_mean(band, band.centre), segment if forward else _turned_round(segment)))
    if not lanes:
        return None
    lanes.sort(key=lambda item: -item[0] if forward else item[0])
    _allow_changes(lanes, section, middle)
    carriageway = Carriageway(road, forward, start, end, [segment for _, segment in lanes])
    for segment in carriageway.lanes:
        segment.carriageway = carriageway
    return carriageway


def _mean(band: LaneBand, values: np.ndarray) -> float:
    return float(values[0] if band.constant else values.mean())


def _turned_round(segment: LaneSegment) -> LaneSegment:
    x, y, heading = segment.at(segment.length)
    segment.x, segment.y, segment.heading = x, y, heading + math.pi
    segment.curvature = -segment.curvature if segment.curvature != 0.0 else 0.0
    segment.elevation, segment.end_elevation = segment.end_elevation, segment.elevation
    return segment


def _allow_changes(lanes: list[tuple[float, LaneSegment]], section: LaneSection, s: float) -> None:
    """Note where the marks between two neighbouring lanes allow a change from one to the other."""
    for (left_t, left), (right_t, right) in itertools.pairwise(lanes):
        if abs(left_t - right_t) > 0.5 * (left.width + right.width) + 0.5:
            continue
        left.may_right = _may_change(section, left.lane.id, right.lane.id, s)
        right.may_left = _may_change(section, right.lane.id, left.lane.id, s)


def _may_change(section: LaneSection, origin: int, target: int, s: float) -> bool:
    """The mark on a lane's outer side is its own: between two lanes it is that of the inner one."""
    if origin * target < 0:
        return True
    inner = section.lanes[min(origin, target, key=abs)]
    place = bisect_right(inner.marks, s + 1e-6, key=lambda mark: mark.s)
    if not place:
        return True
    mark = inner.marks[place - 1]
    return mark.increase if target > origin else mark.decrease
