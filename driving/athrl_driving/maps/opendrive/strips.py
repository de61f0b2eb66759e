"""A road's lanes as strips: all lanes of one direction between two stations, each a line or an arc.

Everything that leaves this module is in the towns' frame: y grows to the right of x and headings grow
clockwise, as in highway-env. A strip's lanes are those of one driving direction, from the left to the right.
"""

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from athrl_driving.maps.opendrive.cross_section import (
    LaneBand,
    bands_at,
    breakpoints,
    climbs_evenly,
    elevation_at,
    is_too_narrow,
    speed_limit_at,
)
from athrl_driving.maps.opendrive.model import Lane, LaneSection, OpenDrive, Road
from athrl_driving.maps.opendrive.reference_line import (
    Poses,
    check_reference_line,
    curvature_of,
    geometry_at,
    geometry_poses,
)

TOLERANCE = 0.005
"""Metres: how far an arc may be from a sampled point of the lane that it stands for (promised: 1 cm)."""

DEFAULT_LIMIT = 50.0 / 3.6
"""m/s, where the file has no speed limit."""

ELEVATION_TOLERANCE = 0.25
_LONGEST_FIT = 20.0
_SHORTEST_FIT = 0.02
_SAMPLES = 9
_FLAT = 1e-7


@dataclass(slots=True, eq=False)
class LanePiece:
    """One lane of a strip, in driving direction: its start (m, m, rad), curvature (1/m) and length (m)."""

    lane: Lane
    keys: list[tuple[int, int]]
    """The (section, lane id) that it covers, in driving order."""
    x: float
    y: float
    heading: float
    curvature: float
    length: float
    width: float
    limit: float
    elevation: float
    end_elevation: float
    successors: list["LanePiece"] = field(default_factory=list, repr=False)
    may_left: bool = False
    may_right: bool = False
    junction: str = ""
    """The junction that it is a way through; empty on ordinary road."""
    strip: "Strip" = field(init=False, repr=False)

    def at(self, s: float) -> tuple[float, float, float]:
        """Return (x, y, heading) at `s` metres from the start; outside of it too."""
        heading = self.heading + self.curvature * s
        if self.curvature == 0.0:
            return self.x + s * math.cos(heading), self.y + s * math.sin(heading), heading
        x = self.x + (math.sin(heading) - math.sin(self.heading)) / self.curvature
        y = self.y - (math.cos(heading) - math.cos(self.heading)) / self.curvature
        return x, y, heading


@dataclass(slots=True, eq=False)
class Strip:
    """The lanes of one direction between the stations `start` < `end` of a road."""

    road: Road
    forward: bool
    start: float
    end: float
    lanes: list[LanePiece]


def road_strips(content: OpenDrive, road: Road) -> list[Strip]:
    """Return a road's strips: first those along growing stations, then the others, each in driving order."""
    check_reference_line(content, road)
    strips: list[Strip] = []
    for number, section in enumerate(road.sections):
        cuts = breakpoints(content, road, section)
        for start, end in itertools.pairwise(cuts):
            strips += _interval(content, road, number, section, start, end)
    forward = [strip for strip in strips if strip.forward]
    return forward + [strip for strip in reversed(strips) if not strip.forward]


def _interval(
    content: OpenDrive, road: Road, number: int, section: LaneSection, start: float, end: float
) -> list[Strip]:
    """Return the strips between two neighbouring breakpoints; halved until every lane is a line or an arc."""
    curvature = curvature_of(geometry_at(road, start))
    stations = np.linspace(start, end, _SAMPLES)
    bands = bands_at(content, road, section, stations)
    if not bands:
        return []
    exact = curvature is not None and all(band.constant for band in bands.values())
    even = climbs_evenly(road, start, end, ELEVATION_TOLERANCE)
    turning = max(abs(curvature or 0.0) * (end - start), 0.0)
    fitted: list[tuple[LaneBand, _Fit]] | None = None
    if even and turning < 2.0 and (exact or end - start <= _LONGEST_FIT):
        fitted = _exact_fits(content, road, bands, start, end) if exact else _fits(road, bands, stations)
    if fitted is None:
        middle = 0.5 * (start + end)
        if end - start < _SHORTEST_FIT:
            lane = next(iter(bands.values())).lane
            raise content.error(road.id, lane.id, lane.line, f"it has a kink at s = {middle:.2f} m")
        first = _interval(content, road, number, section, start, middle)
        return first + _interval(content, road, number, section, middle, end)
    return [
        strip
        for forward in (True, False)
        if (strip := _strip(road, number, section, start, end, forward, fitted)) is not None
    ]


@dataclass(frozen=True, slots=True)
class _Fit:
    """A line or an arc in OpenDRIVE's frame, along growing stations."""

    x: float
    y: float
    heading: float
    curvature: float
    length: float


def _exact_fits(
    content: OpenDrive, road: Road, bands: dict[int, LaneBand], start: float, end: float
) -> list[tuple[LaneBand, _Fit]]:
    geometry = geometry_at(road, start)
    pose = geometry_poses(geometry, np.array([start - geometry.s]))
    x, y, heading = float(pose.x[0]), float(pose.y[0]), float(pose.heading[0])
    curvature = curvature_of(geometry) or 0.0
    fits = []
    for band in bands.values():
        t = float(band.centre[0])
        stretch = 1.0 - curvature * t
        if stretch <= 0.01:
            message = f"it lies {abs(t):.2f} m inside a curve of radius {1.0 / abs(curvature):.2f} m"
            raise content.error(road.id, band.lane.id, band.lane.line, message)
        bent = curvature / stretch if abs(curvature) > _FLAT else 0.0
        place = (x - t * math.sin(heading), y + t * math.cos(heading))
        fits.append((band, _Fit(*place, heading, bent, (end - start) * stretch)))
    return fits


def _fits(road: Road, bands: dict[int, LaneBand], stations: np.ndarray) -> list[tuple[LaneBand, _Fit]] | None:
    """Return for every lane the arc through its start, middle and end, or None where one is too far off."""
    geometry = geometry_at(road, float(stations[0]))
    line = geometry_poses(geometry, stations - geometry.s)
    fits = []
    for band in bands.values():
        x = line.x - band.centre * np.sin(line.heading)
        y = line.y + band.centre * np.cos(line.heading)
        fit = _arc_through(x, y)
        if fit is None or _distance(fit, Poses(x, y, line.heading)) > TOLERANCE:
            return None
        fits.append((band, fit))
    return fits


def _arc_through(x: np.ndarray, y: np.ndarray) -> _Fit | None:
    middle = len(x) // 2
    chord_x, chord_y = float(x[-1] - x[0]), float(y[-1] - y[0])
    chord = math.hypot(chord_x, chord_y)
    if chord < 1e-9:
        return None
    towards_x, towards_y = float(x[middle] - x[0]), float(y[middle] - y[0])
    # The circle through three points: its curvature is 4 * area / (product of the sides).
    area = 0.5 * (towards_x * chord_y - towards_y * chord_x)
    sides = chord * math.hypot(towards_x, towards_y)
    sides *= math.hypot(float(x[-1] - x[middle]), float(y[-1] - y[middle]))
    if sides == 0.0:
        return None
    curvature = 4.0 * area / sides
    half_turn = math.asin(max(-1.0, min(1.0, 0.5 * chord * curvature)))
    heading = math.atan2(chord_y, chord_x) - half_turn
    if abs(curvature) * chord * chord < 8.0 * _FLAT * 100.0:
        return _Fit(float(x[0]), float(y[0]), math.atan2(chord_y, chord_x), 0.0, chord)
    return _Fit(float(x[0]), float(y[0]), heading, curvature, 2.0 * half_turn / curvature)


def _distance(fit: _Fit, poses: Poses) -> float:
    """Return the greatest distance (m) of the points from the line or arc."""
    dx, dy = poses.x - fit.x, poses.y - fit.y
    cos, sin = math.cos(fit.heading), math.sin(fit.heading)
    if fit.curvature == 0.0:
        return float(np.abs(dy * cos - dx * sin).max())
    radius = 1.0 / fit.curvature
    return float(np.abs(np.hypot(dx + radius * sin, dy - radius * cos) - abs(radius)).max())


def _strip(
    road: Road,
    number: int,
    section: LaneSection,
    start: float,
    end: float,
    forward: bool,
    fitted: list[tuple[LaneBand, _Fit]],
) -> Strip | None:
    lanes: list[tuple[float, LanePiece]] = []
    middle, first, last = 0.5 * (start + end), elevation_at(road, start), elevation_at(road, end)
    for band, fit in fitted:
        lane, width = band.lane, _mean(band, band.width)
        if road.drives_forward(lane) != forward or is_too_narrow(lane, section, width):
            continue
        piece = LanePiece(
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
        lanes.append((_mean(band, band.centre), piece if forward else _turned_round(piece)))
    if not lanes:
        return None
    lanes.sort(key=lambda item: -item[0] if forward else item[0])
    _allow_changes(lanes, section, middle)
    strip = Strip(road, forward, start, end, [piece for _, piece in lanes])
    for piece in strip.lanes:
        piece.strip = strip
    return strip


def _mean(band: LaneBand, values: np.ndarray) -> float:
    return float(values[0] if band.constant else values.mean())


def _turned_round(piece: LanePiece) -> LanePiece:
    x, y, heading = piece.at(piece.length)
    piece.x, piece.y, piece.heading = x, y, heading + math.pi
    piece.curvature = -piece.curvature if piece.curvature != 0.0 else 0.0
    piece.elevation, piece.end_elevation = piece.end_elevation, piece.elevation
    return piece


def _allow_changes(lanes: list[tuple[float, LanePiece]], section: LaneSection, s: float) -> None:
    """Note where the marks between two lanes side by side let one change to the other."""
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
    marks = [mark for mark in inner.marks if mark.s <= s + 1e-6]
    if not marks:
        return True
    return marks[-1].increase if target > origin else marks[-1].decrease
