"""Lanes between two stations as lines and arcs, in OpenDRIVE's frame and along growing stations."""

import math
from dataclasses import dataclass, field

import numpy as np

from athrl_driving.maps.opendrive.cross_section import LaneBand
from athrl_driving.maps.opendrive.model import OpenDrive, Road
from athrl_driving.maps.opendrive.reference_line import (
    Floats,
    Poses,
    curvature_of,
    geometry_at,
    geometry_poses,
)

TOLERANCE = 0.005
"""Metres: how far an arc may be from a sampled point of the lane that it stands for (promised: 1 cm)."""

_FLAT = 1e-7
_INSIDE = 0.05
"""Metres that a lane goes on for each metre of its road: with less it is near the centre of its curve."""
_MOST_TURN = 2.0
"""Radians of one arc: its ends and its middle tell no more than half a circle apart."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A line or an arc: start (m, m, rad), curvature (1/m) and length (m)."""

    x: float
    y: float
    heading: float
    curvature: float
    length: float


@dataclass(frozen=True, slots=True)
class Fitted:
    """The lanes that are lines or arcs, and those that no vehicle can drive on here."""

    lanes: list[tuple[LaneBand, Fit]] = field(default_factory=list)
    inside: list[LaneBand] = field(default_factory=list)
    """Beyond the centre of their curve: they would lead backwards."""


def exact_fits(road: Road, bands: dict[int, LaneBand], start: float, end: float) -> Fitted:
    """Return the lanes beside a line or an arc, all of constant width and offset."""
    geometry = geometry_at(road, 0.5 * (start + end))
    pose = geometry_poses(geometry, np.array([start - geometry.s]))
    x, y, heading = float(pose.x[0]), float(pose.y[0]), float(pose.heading[0])
    curvature = curvature_of(geometry) or 0.0
    fitted = Fitted()
    for band in bands.values():
        t = float(band.centre[0])
        stretch = 1.0 - curvature * t
        if stretch <= _INSIDE:
            fitted.inside.append(band)
            continue
        bent = curvature / stretch if abs(curvature) > _FLAT else 0.0
        place = (x - t * math.sin(heading), y + t * math.cos(heading))
        fitted.lanes.append((band, Fit(*place, heading, bent, (end - start) * stretch)))
    return fitted


def fits(road: Road, bands: dict[int, LaneBand], stations: Floats) -> Fitted | None:
    """Return for every lane the arc through its start, middle and end, or None where one is too far off."""
    line = _line(road, stations)
    if abs(float(line.heading[-1] - line.heading[0])) > _MOST_TURN:
        return None
    cos, sin = math.cos(line.heading[len(stations) // 2]), math.sin(line.heading[len(stations) // 2])
    least = _INSIDE * float(stations[-1] - stations[0])
    fitted = Fitted()
    for band in bands.values():
        lane = _beside(line, band.centre)
        if float(lane.x[-1] - lane.x[0]) * cos + float(lane.y[-1] - lane.y[0]) * sin <= least:
            if not (_progress(lane, stations) <= _INSIDE).all():
                return None
            fitted.inside.append(band)
            continue
        fit = _close_arc(lane)
        if fit is None:
            return None
        fitted.lanes.append((band, fit))
    return fitted


def forced_fits(content: OpenDrive, road: Road, bands: dict[int, LaneBand], stations: Floats) -> Fitted:
    """Return the lanes that do fit on a piece too short to be divided; the others are left out and noted.

    Raises `MapError` where the reference line itself has a kink.
    """
    line = _line(road, stations)
    if _close_arc(line) is None:
        message = f"its reference line has a kink at s = {stations.mean():.2f} m"
        raise content.error(road.id, None, geometry_at(road, float(stations.mean())).line, message)
    fitted = Fitted()
    for band in bands.values():
        lane = _beside(line, band.centre)
        progress = _progress(lane, stations)
        fit = _close_arc(lane)
        if (progress <= _INSIDE).any():
            fitted.inside.append(band)
        elif fit is None:
            content.note("a lane was left out where it has a kink", road.id, band.lane.id, band.lane.line)
        else:
            fitted.lanes.append((band, fit))
    return fitted


def arc_through(x: Floats, y: Floats) -> Fit | None:
    """Return the line or arc through the first, the middle and the last of some points (m), None for one."""
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
        return Fit(float(x[0]), float(y[0]), math.atan2(chord_y, chord_x), 0.0, chord)
    return Fit(float(x[0]), float(y[0]), heading, curvature, 2.0 * half_turn / curvature)


def _line(road: Road, stations: Floats) -> Poses:
    geometry = geometry_at(road, 0.5 * (float(stations[0]) + float(stations[-1])))
    return geometry_poses(geometry, stations - geometry.s)


def _beside(line: Poses, t: Floats) -> Poses:
    """Return the points `t` metres (array [n]) to the left of a line's."""
    return Poses(line.x - t * np.sin(line.heading), line.y + t * np.cos(line.heading), line.heading)


def _progress(lane: Poses, stations: Floats) -> Floats:
    """Return how many metres a lane goes on between its points for each metre of its road."""
    heading = 0.5 * (lane.heading[1:] + lane.heading[:-1])
    along = np.diff(lane.x) * np.cos(heading) + np.diff(lane.y) * np.sin(heading)
    return along / np.diff(stations)


def _close_arc(lane: Poses) -> Fit | None:
    fit = arc_through(lane.x, lane.y)
    return fit if fit is not None and _distance(fit, lane) <= TOLERANCE else None


def _distance(fit: Fit, poses: Poses) -> float:
    """Return the greatest distance (m) of the points from the line or arc."""
    dx, dy = poses.x - fit.x, poses.y - fit.y
    cos, sin = math.cos(fit.heading), math.sin(fit.heading)
    if fit.curvature == 0.0:
        return float(np.abs(dy * cos - dx * sin).max())
    radius = 1.0 / fit.curvature
    return float(np.abs(np.hypot(dx + radius * sin, dy - radius * cos) - abs(radius)).max())
