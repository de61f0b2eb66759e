"""Lanes as lines and areas of points, for drawing."""

from typing import NamedTuple

import numpy as np

from athrl_driving.maps.lane_graph import Floats, Integers


class LaneShapes(NamedTuple):
    """Centre lines of lanes, each a line or an arc; all are float64 [lanes]."""

    x: Floats
    """m, where it starts."""
    y: Floats
    """m, where it starts."""
    heading: Floats
    """rad, where it starts."""
    curvature: Floats
    """1/m."""
    length: Floats
    """m."""


def centre_lines(shapes: LaneShapes, spacing: float) -> list[Floats]:
    """Return lines and arcs as points [n, 2] in metres, at most `spacing` metres apart."""
    lines = []
    for lane, metres in enumerate(shapes.length.tolist()):
        straight = shapes.curvature[lane] == 0.0 or metres <= spacing
        s = np.linspace(0.0, metres, 2 if straight else int(np.ceil(metres / spacing)) + 1)
        lines.append(points_on(shapes, np.full(len(s), lane), s))
    return lines


def points_on(shapes: LaneShapes, lanes: Integers, s: Floats) -> Floats:
    """Return the points [n, 2] in metres at `s` metres [n] along lanes [n]."""
    half = 0.5 * shapes.curvature[lanes] * s
    # The chord of an arc: its length is s * sinc(half the turn), its direction half the turn.
    chord, direction = s * np.sinc(half / np.pi), shapes.heading[lanes] + half
    x, y = shapes.x[lanes] + chord * np.cos(direction), shapes.y[lanes] + chord * np.sin(direction)
    return np.stack([x, y], axis=1)


def outlines(lines: list[Floats], widths: Floats) -> list[Floats]:
    """Return the areas around centre lines [n, 2]: outlines [2n, 2], as wide as `widths` [lanes]; all m."""
    areas = []
    for line, width in zip(lines, widths.tolist(), strict=True):
        along = np.gradient(line, axis=0)
        along /= np.maximum(np.hypot(along[:, :1], along[:, 1:]), 1e-9)
        across = 0.5 * width * np.stack([-along[:, 1], along[:, 0]], axis=1)
        areas.append(np.concatenate([line + across, (line - across)[::-1]]))
    return areas
