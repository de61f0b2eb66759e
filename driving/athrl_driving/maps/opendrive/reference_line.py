"""Where a road's reference line is at a station, for every kind of geometry, evaluated as it is defined."""

import math
from bisect import bisect_right
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.opendrive.bounds import GAP, LARGEST_GAP, MOST_TURN, SHARE_OF_GAP
from athrl_driving.maps.opendrive.model import Bend, Geometry, OpenDrive, Road

Floats = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_SPIRAL_STEP = 0.25
"""Radians that a spiral may turn between two nodes of the integration."""
_POLYNOMIAL_STEPS = 64


@dataclass(frozen=True, slots=True)
class Poses:
    """Points on a line: m, m, rad; arrays of one length. OpenDRIVE's frame."""

    x: Floats
    y: Floats
    heading: Floats


def curvature_of(geometry: Geometry) -> float | None:
    """Return the curvature (1/m) of a line or an arc, None for what is neither."""
    if geometry.bend is not None:
        return None
    if geometry.kind == "line":
        return 0.0
    return geometry.parameters[0] if geometry.kind == "arc" else None


def geometry_poses(geometry: Geometry, ds: Floats) -> Poses:
    """Return the poses `ds` metres (array [n], ascending) behind a geometry's start."""
    if geometry.kind == "line":
        u, v, turned = _arc(0.0, ds)
    elif geometry.kind == "arc":
        u, v, turned = _arc(geometry.parameters[0], ds)
    elif geometry.kind == "spiral":
        u, v, turned = _spiral(geometry, ds)
    elif geometry.kind == "poly3":
        u, v, turned = _poly3(geometry, ds)
    else:
        u, v, turned = _param_poly3(geometry, ds)
    cos, sin = math.cos(geometry.heading), math.sin(geometry.heading)
    x, y = geometry.x + u * cos - v * sin, geometry.y + u * sin + v * cos
    if geometry.bend is not None:
        x, y = _bent(geometry.bend, x, y, ds)
    return Poses(x, y, geometry.heading + turned)


def _bent(bend: Bend, x: Floats, y: Floats, ds: Floats) -> tuple[Floats, Floats]:
    """Move points as a bend says. Headings stay, so that lanes are moved by as much as their line."""
    share = ds / bend.span
    (start_x, start_y), (end_x, end_y) = bend.start, bend.end
    return x + start_x + share * (end_x - start_x), y + start_y + share * (end_y - start_y)


def geometry_at(road: Road, s: float) -> Geometry:
    """Return the geometry at a station of a road."""
    place = bisect_right(road.geometries, s + 1e-9, key=lambda geometry: geometry.s)
    return road.geometries[max(place - 1, 0)]


def close_reference_line(content: OpenDrive, road: Road) -> None:
    """Bend the parts of a road's reference line to each other where it jumps a little.

    The longer of two parts is bent: its points are moved, by the whole jump at the joint and by nothing at
    its other end. Raises `MapError` where the jump is too large.
    """
    _check_turns(content, road)
    for place in range(len(road.geometries) - 1):
        geometry, following = road.geometries[place], road.geometries[place + 1]
        end = geometry_poses(geometry, np.array([following.s - geometry.s]))
        jump = (following.x - float(end.x[0]), following.y - float(end.y[0]))
        gap = math.hypot(*jump)
        if gap <= GAP:
            continue
        behind = road.geometries[place + 2].s if place + 2 < len(road.geometries) else road.length
        spans = following.s - geometry.s, behind - following.s
        if round(gap, 3) > min(LARGEST_GAP, SHARE_OF_GAP * max(spans)):
            message = f"the reference line jumps by {gap:.3f} m at s = {following.s:.3f} m, {_allowed(spans)}"
            raise content.error(road.id, None, following.line, message)
        content.note("a gap in the reference line was bridged", road.id, None, following.line, gap)
        _meet(road, place, jump, spans)


def _meet(road: Road, place: int, jump: tuple[float, float], spans: tuple[float, float]) -> None:
    """Bend the longer of the geometries `place` and `place` + 1, so that they meet."""
    geometry, following = road.geometries[place], road.geometries[place + 1]
    if spans[0] >= spans[1]:
        bend = replace(geometry.bend or Bend(spans[0]), end=jump)
        road.geometries[place] = replace(geometry, bend=bend)
    else:
        bend = Bend(spans[1], start=(-jump[0], -jump[1]))
        road.geometries[place + 1] = replace(following, bend=bend)


def _allowed(spans: tuple[float, float]) -> str:
    share = SHARE_OF_GAP * max(spans)
    if share >= LARGEST_GAP:
        return f"at most {LARGEST_GAP} m may be"
    return f"at most {share:.3f} m may be beside parts of {spans[0]:.3f} and {spans[1]:.3f} m"


def _check_turns(content: OpenDrive, road: Road) -> None:
    """Refuse lines and arcs that turn round and round: each turn is several pieces."""
    ends = [*(geometry.s for geometry in road.geometries[1:]), road.length]
    for geometry, end in zip(road.geometries, ends, strict=True):
        turn = _mean_bend(geometry) * max(geometry.length, end - geometry.s)
        if turn > MOST_TURN:
            message = f"its <{geometry.kind}> turns by up to {turn:,.0f} rad, at most {MOST_TURN:g} may be"
            raise content.error(road.id, None, geometry.line, message)


def _mean_bend(geometry: Geometry) -> float:
    """Return the mean of the curvature's absolute value (1/m) along a geometry; 0 of a formula."""
    if geometry.kind == "arc":
        return abs(geometry.parameters[0])
    if geometry.kind != "spiral":
        return 0.0
    first, last = geometry.parameters
    together = abs(first) + abs(last)
    if first * last >= 0.0:
        return 0.5 * together
    return 0.5 * (first**2 + last**2) / together


def _arc(curvature: float, ds: Floats) -> tuple[Floats, Floats, Floats]:
    if abs(curvature) < 1e-12:
        return ds, np.zeros_like(ds), np.zeros_like(ds)
    turned = curvature * ds
    # 1 - cos in a form that keeps its digits where the arc is flat.
    return np.sin(turned) / curvature, 2.0 * np.sin(0.5 * turned) ** 2 / curvature, turned


def _spiral(geometry: Geometry, ds: Floats) -> tuple[Floats, Floats, Floats]:
    """A clothoid: the curvature is linear in the length. Its position is integrated (Gauss-Legendre)."""
    start, end = geometry.parameters
    slope = (end - start) / geometry.length if geometry.length > 0.0 else 0.0
    limits, sharpest = np.concatenate([[0.0], ds]), max(abs(start), abs(end))
    parts = max(1, math.ceil(float(np.max(np.diff(limits))) * sharpest / _SPIRAL_STEP))
    fine = np.concatenate(
        [np.linspace(a, b, parts, endpoint=False) for a, b in zip(limits, ds, strict=False)]
    )
    fine = np.append(fine, ds[-1])
    half = 0.5 * np.diff(fine)
    nodes = (0.5 * (fine[1:] + fine[:-1]))[:, None] + half[:, None] * _NODES
    angle = nodes * (start + 0.5 * slope * nodes)
    u = np.cumsum(half * (np.cos(angle) @ _WEIGHTS))[parts - 1 :: parts]
    v = np.cumsum(half * (np.sin(angle) @ _WEIGHTS))[parts - 1 :: parts]
    return u, v, ds * (start + 0.5 * slope * ds)


def _poly3(geometry: Geometry, ds: Floats) -> tuple[Floats, Floats, Floats]:
    """v(u) is a cubic; the station is the length along it, so u is found by inverting the length."""
    a, b, c, d = geometry.parameters
    u = _inverted_length(b, c, d, ds)
    return u, a + u * (b + u * (c + u * d)), np.arctan(b + u * (2.0 * c + u * 3.0 * d))


def _inverted_length(b: float, c: float, d: float, ds: Floats) -> Floats:
    """Return u where the curve v(u) is `ds` metres long."""
    reach = float(np.max(ds))
    if reach == 0.0:
        return ds.copy()
    edges = np.linspace(0.0, reach, _POLYNOMIAL_STEPS + 1)
    half = 0.5 * reach / _POLYNOMIAL_STEPS
    nodes = (0.5 * (edges[1:] + edges[:-1]))[:, None] + half * _NODES
    speed = np.hypot(1.0, b + nodes * (2.0 * c + nodes * 3.0 * d))
    length = np.concatenate([[0.0], np.cumsum(half * (speed @ _WEIGHTS))])
    u = np.interp(ds, length, edges)
    for _ in range(4):
        # Newton: the length up to u, from the nearest edge before it.
        place = np.clip((u / reach * _POLYNOMIAL_STEPS).astype(np.int64), 0, _POLYNOMIAL_STEPS - 1)
        part = 0.5 * (u - edges[place])
        inner = edges[place][:, None] + part[:, None] * (1.0 + _NODES)
        travelled = length[place] + part * (np.hypot(1.0, b + inner * (2.0 * c + inner * 3.0 * d)) @ _WEIGHTS)
        u = u - (travelled - ds) / np.hypot(1.0, b + u * (2.0 * c + u * 3.0 * d))
    return u


def _param_poly3(geometry: Geometry, ds: Floats) -> tuple[Floats, Floats, Floats]:
    """u(p) and v(p) are cubics; p is the length, or runs from 0 to 1 in proportion to it."""
    a_u, b_u, c_u, d_u, a_v, b_v, c_v, d_v, normalized = geometry.parameters
    p = ds / geometry.length if normalized and geometry.length > 0.0 else ds
    u = a_u + p * (b_u + p * (c_u + p * d_u))
    v = a_v + p * (b_v + p * (c_v + p * d_v))
    slope_u = b_u + p * (2.0 * c_u + p * 3.0 * d_u)
    slope_v = b_v + p * (2.0 * c_v + p * 3.0 * d_v)
    # The angle seen from the start: unwrapped, so that a curve may turn further than half a circle.
    return u, v, np.unwrap(np.arctan2(slope_v, slope_u))
