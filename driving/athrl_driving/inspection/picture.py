"""Draws a town as a plan: lanes, ways through junctions, driving directions, lights, and what is left out."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pygame
from athrl_spaces.wording import system_reason
from numpy.typing import NDArray

from athrl_driving.errors import DrivingError
from athrl_driving.inspection.facts import MapFacts, facts_of, ways_out
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

_WIDTH_LEFT_OUT = 2.0
"""Metres: less than of a lane, as they lie over those that are driven on."""
_ARROW_EVERY = 60
"""Pixels between two arrows in one direction, about."""
_DIRECTIONS = 8


def draw_town(town: Town, picture: str | os.PathLike[str]) -> None:
    """Draw a town into a PNG file. Raises `DrivingError` where the file cannot be written."""
    left_out = centre_lines(town.left_out_shapes, spacing=2.0)
    lines = town.lane_polylines()
    plan = Plan(np.concatenate([*lines, *left_out]))
    _draw_lanes(plan, town, lines)
    _draw_left_out(plan, left_out)
    _draw_directions(plan, town, lines)
    _draw_lights(plan, town, lines)
    for lane in ways_out(town.graph).tolist():
        plan.dot(lines[lane][-1], WAY_OUT)
    plan.finish(_title(facts_of(town)), _legend(town))
    try:
        pygame.image.save(plan.surface, Path(picture))
    except (OSError, pygame.error) as error:
        cause = system_reason(error) if isinstance(error, OSError) else str(error)
        raise DrivingError(f"{picture}: the picture could not be written: {cause}") from None


def _draw_left_out(plan: Plan, lines: list[NDArray[np.float64]]) -> None:
    width = max(_WIDTH_LEFT_OUT, plan.least_width)
    for area in outlines(lines, np.full(len(lines), width)):
        plan.area(area, LEFT_OUT)


def _draw_lanes(plan: Plan, town: Town, lines: list[NDArray[np.float64]]) -> None:
    """Draw from the lowest level up, on each level those through junctions first."""
    graph = town.graph
    areas = outlines(lines, np.maximum(graph.width, plan.least_width))
    level = np.round((graph.elevation + 0.5 * graph.grade * graph.length) / ROAD_LEVEL_HEIGHT)
    for lane in np.lexsort((graph.movement < 0, level)).tolist():
        plan.area(areas[lane], IN_JUNCTION if graph.movement[lane] >= 0 else LANE)


def _draw_directions(plan: Plan, town: Town, lines: list[NDArray[np.float64]]) -> None:
    """Draw arrows on the lanes of roads, of each direction one in each square of the plan."""
    seen: set[tuple[int, int, int]] = set()
    for lane in np.flatnonzero(town.graph.movement < 0).tolist():
        line = lines[lane]
        middle = len(line) // 2
        place, ahead = 0.5 * (line[middle - 1] + line[middle]), line[middle] - line[middle - 1]
        column, row = (plan.pixel(place) // _ARROW_EVERY).tolist()
        angle = np.arctan2(ahead[1], ahead[0]) / (2.0 * np.pi)
        square = (column, row, round(_DIRECTIONS * float(angle)) % _DIRECTIONS)
        if square not in seen:
            seen.add(square)
            plan.arrow(place, ahead, _ARROW)


def _draw_lights(plan: Plan, town: Town, lines: list[NDArray[np.float64]]) -> None:
    """Draw a dot at each stop line before a light."""
    movements = town.movements
    for lane in np.unique(movements.origin[movements.signal >= 0]).tolist():
        plan.dot(lines[lane][-1], LIGHT)


def _title(facts: MapFacts) -> str:
    driven, left_out = facts.driven, facts.metres_left_out
    text = f"{facts.name}: {driven.kilometres:.2f} km of lanes are driven on"
    return text + (f", {left_out / 1000.0:.2f} km are left out" if left_out else "")


def _legend(town: Town) -> list[tuple[str, tuple[int, int, int]]]:
    entries = [("lanes", LANE)]
    if (town.graph.movement >= 0).any():
        entries.append(("ways through junctions", IN_JUNCTION))
    if (town.movements.signal >= 0).any():
        entries.append(("traffic lights", LIGHT))
    if ways_out(town.graph).size:
        entries.append(("ways out of the map", WAY_OUT))
    if town.left_out:
        entries.append(("left out", LEFT_OUT))
    return entries
