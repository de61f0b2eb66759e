"""The ground of a town as `render` draws it: what is asphalt, on which level, and the marks on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pygame
from highway_env.road.graphics import LaneGraphics, WorldSurface
from highway_env.road.lane import AbstractLane
from numpy.typing import NDArray

from athrl_driving.maps import Town

LEVEL = 3.0
"""Difference in elevation from which on one lane hides another or what drives there, m."""

MEADOW = (206, 212, 196)
ASPHALT = WorldSurface.GREY
WAY = (112, 112, 112)
"""Of the ways through junctions, which lie over each other."""


@dataclass(frozen=True)
class Ground:
    """The lanes of a town, ways through junctions too, ready to be drawn."""

    town: Town

    @cached_property
    def levels(self) -> NDArray[np.int64]:
        """int64 [rows]: the level on which each lane lies in its middle, from the lowest up."""
        graph = self.town.graph
        return level_of(graph.elevation + 0.5 * graph.grade * graph.length)

    @cached_property
    def _surfaces(self) -> list[NDArray[np.float64]]:
        """Each lane's outline, float64 [points, 2], m."""
        outlines = []
        for line, width in zip(self.town.lane_polylines(), self.town.graph.width.tolist(), strict=True):
            along = np.gradient(line, axis=0)
            along /= np.maximum(np.hypot(along[:, :1], along[:, 1:]), 1e-9)
            across = 0.5 * width * np.stack([-along[:, 1], along[:, 0]], axis=1)
            outlines.append(np.concatenate([line + across, (line - across)[::-1]]))
        return outlines

    @cached_property
    def _marked(self) -> list[AbstractLane]:
        """Each lane as highway-env's, which knows how its marks are drawn."""
        return [self.town.network.get_lane(index) for index in self.town.lane_indices]

    def visible(self, surface: WorldSurface) -> NDArray[np.int64]:
        """The lanes of which something may be seen, int64 [n]."""
        west, north = surface.origin
        east, south = surface.origin + np.array(surface.get_size()) / surface.scaling
        box = self.town.graph.box
        seen = (box[:, 0] <= east) & (box[:, 2] >= west) & (box[:, 1] <= south) & (box[:, 3] >= north)
        return np.flatnonzero(seen)

    def draw(self, surface: WorldSurface, rows: NDArray[np.int64]) -> None:
        """Draw these lanes: the ways through junctions first, so that roads end with their marks."""
        in_junction = self.town.graph.movement[rows] >= 0
        for row in rows[in_junction].tolist():
            self._fill(surface, row, WAY)
        for row in rows[~in_junction].tolist():
            self._fill(surface, row, ASPHALT)
        for row in rows[~in_junction].tolist():
            LaneGraphics.display(self._marked[row], surface)

    def _fill(self, surface: WorldSurface, row: int, colour: tuple[int, int, int]) -> None:
        points = ((self._surfaces[row] - surface.origin) * surface.scaling).tolist()
        pygame.draw.polygon(surface, colour, points)
        pygame.draw.polygon(surface, colour, points, 1)  # its edge too, so that no seam is left to the next


def level_of(elevation: NDArray[np.float64]) -> NDArray[np.int64]:
    """The level of each elevation (m), int64."""
    return np.round(elevation / LEVEL).astype(np.int64)
