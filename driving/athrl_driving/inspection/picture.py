"""Draws a town as a plan: lanes, ways through junctions, driving directions, lights, and what is left out."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pygame
from athrl_spaces.wording import system_reason
from numpy.typing import NDArray

from athrl_driving.errors import DrivingError
from athrl_driving.inspection.facts import MapFacts, facts_of, lanes_before_lights, ways_out
from athrl_driving.inspection.plan import Plan
from athrl_driving.maps import Town
from athrl_driving.maps.levels import ROAD_LEVEL_HEIGHT
from athrl_driving.maps.outlines import centre_lines, outlines

LANE = (92, 103, 125)
IN_JUNCTION = (233, 184, 114)
LEFT_OUT = (214, 40, 40)
LIGHT = (30, 150, 90)
WAY_OUT = (30, 110, 210)
_ARROW = (255, 255, 255)

_BETWEEN_LANES = (168, 176, 192)

_WIDTH_LEFT_OUT = 2.0
"""Metres: less than of a lane, as they lie over those that are driven on."""
_ARROW_EVERY = 60
"""Pixels between two arrows on a lane, about."""
_ARROWS_APART = 22
"""Pixels between two arrows in one direction at least, so that short lanes are not full of them."""
_DIRECTIONS = 8
_SEEN_APART = 3.0
"""Pixels of a lane's width, below which lines beside it would hide it."""


def draw_town(town: Town, picture: str | os.PathLike[str]) -> None:
    """Draw a town into a PNG file. Raises `DrivingError` where the file cannot be written."""
    plan = Plan(_corners(town))
    lines = town.lane_polylines(plan.spacing)
    _draw_lanes(plan, town, lines)
    _draw_left_out(plan, town)
    _draw_directions(plan, town, lines)
    for lane in lanes_before_lights(town).tolist():
        plan.dot(lines[lane][-1], LIGHT)
    for lane in ways_out(town.graph).tolist():
        plan.dot(lines[lane][-1], WAY_OUT)
    plan.finish(_title(facts_of(town)), _legend(town))
    try:
        pygame.image.save(plan.surface, Path(picture))
    except (OSError, pygame.error) as error:
        cause = system_reason(error) if isinstance(error, OSError) else str(error)
        raise DrivingError(f"{picture}: the picture could not be written: {cause}") from None


def _corners(town: Town) -> NDArray[np.float64]:
    """Return points [n, 2] in metres around all that is drawn."""
    driven = outlines(town.lane_polylines(), town.graph.width)
    return np.concatenate([*driven, *centre_lines(town.left_out_shapes, spacing=2.0)])


def _draw_left_out(plan: Plan, town: Town) -> None:
    lines = centre_lines(town.left_out_shapes, plan.spacing)
    width = max(_WIDTH_LEFT_OUT, plan.least_width)
    for area in outlines(lines, np.full(len(lines), width)):
        plan.area(area, LEFT_OUT)


def _draw_lanes(plan: Plan, town: Town, lines: list[NDArray[np.float64]]) -> None:
    """Draw from the lowest level up, on each level those through junctions first."""
    graph = town.graph
    areas = outlines(lines, np.maximum(graph.width, plan.least_width))
    level = np.round((graph.elevation + 0.5 * graph.grade * graph.length) / ROAD_LEVEL_HEIGHT)
    for lane in np.lexsort((graph.movement < 0, level)).tolist():
        in_junction = graph.movement[lane] >= 0
        plan.area(areas[lane], IN_JUNCTION if in_junction else LANE)
        if not in_junction and plan.pixels(float(graph.width[lane])) >= _SEEN_APART:
            left, right = np.split(areas[lane], 2)
            plan.line(left, _BETWEEN_LANES)
            plan.line(right, _BETWEEN_LANES)


def _draw_directions(plan: Plan, town: Town, lines: list[NDArray[np.float64]]) -> None:
    """Draw arrows along the lanes of roads, close together only one in each direction, on the longest."""
    drawn: dict[int, list[NDArray[np.float64]]] = {direction: [] for direction in range(_DIRECTIONS)}
    lanes = np.flatnonzero(town.graph.movement < 0)
    for lane in lanes[np.argsort(-town.graph.length[lanes], kind="stable")].tolist():
        line = lines[lane]
        count = max(1, round(plan.pixels(float(town.graph.length[lane])) / _ARROW_EVERY))
        for place, ahead in _along(line, count):
            angle = np.arctan2(ahead[1], ahead[0]) / (2.0 * np.pi)
            others, pixel = drawn[round(_DIRECTIONS * float(angle)) % _DIRECTIONS], plan.pixel(place)
            if not others or np.hypot(*(np.array(others) - pixel).T).min() >= _ARROWS_APART:
                others.append(pixel)
                plan.arrow(place, ahead, _ARROW)


def _along(
    line: NDArray[np.float64], count: int
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Yield `count` places at equal distances on a line [n, 2], each with the piece of line that it is on."""
    pieces = np.diff(line, axis=0)
    metres = np.concatenate([[0.0], np.cumsum(np.hypot(pieces[:, 0], pieces[:, 1]))])
    for share in (np.arange(count) + 0.5) / count:
        piece = min(int(np.searchsorted(metres, share * metres[-1], side="right")) - 1, len(pieces) - 1)
        within = (share * metres[-1] - metres[piece]) / max(metres[piece + 1] - metres[piece], 1e-9)
        yield line[piece] + within * pieces[piece], pieces[piece]


def _title(facts: MapFacts) -> str:
    driven, left_out = facts.driven, facts.metres_left_out
    text = f"{facts.name}: {driven.kilometres:.2f} km of lanes are driven on"
    return text + (f", {left_out / 1000.0:.2f} km are left out" if left_out else "")


def _legend(town: Town) -> list[tuple[str, tuple[int, int, int]]]:
    entries = [("lanes", LANE)]
    if (town.graph.movement >= 0).any():
        entries.append(("ways through junctions", IN_JUNCTION))
    if lanes_before_lights(town).size:
        entries.append(("stop lines at lights", LIGHT))
    if ways_out(town.graph).size:
        entries.append(("ways out of the map", WAY_OUT))
    if town.left_out:
        entries.append(("left out", LEFT_OUT))
    return entries
