"""Reads a road's reference line."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
from lxml import etree  # type: ignore[import-untyped]

from athrl_driving.maps.opendrive.bounds import GAP, LARGEST_COORDINATE, LARGEST_GAP, SHORTEST_ROAD
from athrl_driving.maps.opendrive.element_reader import ElementReader
from athrl_driving.maps.opendrive.model import Geometry

_GEOMETRIES = {
    "line": (),
    "arc": ("curvature",),
    "spiral": ("curvStart", "curvEnd"),
    "poly3": ("a", "b", "c", "d"),
    "paramPoly3": ("aU", "bU", "cU", "dU", "aV", "bV", "cV", "dV"),
}

_RANGES = {"arclength": 0.0, "normalized": 1.0}
"""The last parameter of a paramPoly3, by the attribute pRange in lower case."""


def read_reference_line(
    reader: ElementReader, road: etree._Element, length: float
) -> tuple[list[Geometry], float]:
    """Return a road's geometries in order, none of no length, and the road's length (m).

    That is `length`, the file's own, except where the geometries are a little longer or shorter. No
    geometries are returned where the file has none. Raises `MapError`: one is no geometry, or they do not
    cover the length.
    """
    geometries = [_read_geometry(reader, item) for item in road.iterfind("planView/geometry")]
    if not geometries:
        return [], length
    geometries.sort(key=lambda geometry: geometry.s)
    # Of two that start at one place the first has no length.
    geometries = [
        geometry
        for geometry, following in itertools.zip_longest(geometries, geometries[1:])
        if following is None or following.s > geometry.s
    ]
    geometries = _from_start(reader, road, geometries)
    length = _length(reader, road, geometries, length)
    if length >= SHORTEST_ROAD:
        return geometries, length
    if length == 0.0:  # some micrometres are what exporters leave where two numbers were rounded
        reader.note(road, "a road of no length was read as a link between those that it is linked to")
    point = replace(geometries[0], s=0.0, length=SHORTEST_ROAD, kind="line", parameters=())
    return [point], SHORTEST_ROAD


def _from_start(reader: ElementReader, road: etree._Element, geometries: list[Geometry]) -> list[Geometry]:
    """Let the reference line start where the road does."""
    late = geometries[0].s
    if late <= GAP:
        return geometries
    if round(late, 3) > LARGEST_GAP:
        raise reader.error(road, f"its reference line starts at {late:.3f} m, it must start at 0 m")
    reader.note(road, "a reference line that starts late was moved to the start of its road", late)
    return [replace(geometry, s=geometry.s - late) for geometry in geometries]


def _length(reader: ElementReader, road: etree._Element, geometries: list[Geometry], length: float) -> float:
    """Return the road's length: that of the reference line, where the two differ."""
    covered = geometries[-1].s + geometries[-1].length
    difference = abs(covered - length)
    if round(difference, 3) > LARGEST_GAP:
        message = (
            f"the reference line goes from {geometries[0].s:.3f} to {covered:.3f} m, the road is "
            f"{length:.3f} m long, they may differ by {LARGEST_GAP} m"
        )
        raise reader.error(road, message)
    if difference <= GAP:
        return length
    reader.note(road, "a road's length was taken from its reference line", difference)
    return covered


def _read_geometry(reader: ElementReader, element: etree._Element) -> Geometry:
    shapes = [child for child in element if child.tag in _GEOMETRIES]
    if len(shapes) != 1:
        kinds = ", ".join(_GEOMETRIES)
        raise reader.error(element, f"a <geometry> must be one of: {kinds}")
    shape = shapes[0]
    parameters = [reader.number(shape, name) for name in _GEOMETRIES[shape.tag]]
    length = reader.length(element)
    if shape.tag == "paramPoly3":
        parameters.append(_range(reader, shape, parameters, length))
    return Geometry(
        s=reader.station(element, "s"),
        x=reader.number(element, "x", LARGEST_COORDINATE),
        y=reader.number(element, "y", LARGEST_COORDINATE),
        heading=reader.number(element, "hdg"),
        length=length,
        kind=shape.tag,
        parameters=tuple(parameters),
        line=element.sourceline or 0,
    )


def _range(reader: ElementReader, shape: etree._Element, parameters: list[float], length: float) -> float:
    """Return 1.0 where the parameter runs from 0 to 1, 0.0 where it is the length."""
    span = shape.get("pRange")
    if not span:
        # Programs do not agree on what holds without it: the speed at the start tells.
        reader.note(shape, "a paramPoly3 without pRange was read by how fast its parameter runs")
        speed = math.hypot(parameters[1], parameters[5])
        return 1.0 if abs(speed - length) < abs(speed - 1.0) else 0.0
    if span.lower() not in _RANGES:
        raise reader.error(shape, f"pRange is {span!r}, it must be arcLength or normalized")
    return _checked_range(reader, shape, parameters, length, _RANGES[span.lower()])


def _checked_range(
    reader: ElementReader, shape: etree._Element, parameters: list[float], length: float, said: float
) -> float:
    """Return the last parameter that the file says, or the other one where only that fits the length.

    Raises `MapError` where neither does: what is drawn would be many times as long as the road, or a point.
    """
    runs = _run(parameters, 1.0 if said else length)
    if length <= LARGEST_GAP or 0.5 * length <= runs <= 2.0 * length:
        return said
    other = _run(parameters, length if said else 1.0)
    if abs(other - length) > 0.1 * length:
        raise reader.error(shape, f"its <paramPoly3> is {runs:.3f} m long, its length is {length:.3f} m")
    reader.note(shape, "a paramPoly3 was read with the other pRange, with which it is as long as it says")
    return 1.0 - said


def _run(parameters: list[float], last: float) -> float:
    """Return the length (m) of a paramPoly3 whose parameter runs from 0 to `last`, of 64 chords."""
    p = np.linspace(0.0, last, 65)
    (_, b, c, d, _, e, f, g) = parameters
    u, v = p * (b + p * (c + p * d)), p * (e + p * (f + p * g))
    return float(np.hypot(np.diff(u), np.diff(v)).sum())
