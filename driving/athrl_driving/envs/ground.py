"""The ground of a town as `render` draws it: asphalt by level, and lane markings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pygame
from highway_env.road.graphics import LaneGraphics, WorldSurface
from highway_env.road.lane import AbstractLane
from numpy.typing import NDArray

from athrl_driving.maps import Town
from athrl_driving.maps.outlines import outlines

LEVEL = 3.0
"""Difference in elevation from which a lane hides another lane and its vehicles, m."""

MEADOW = (206, 212, 196)
ASPHALT = WorldSurface.GREY
WAY = (112, 112, 112)
"""Colour of the lanes through junctions, which overlap."""


@dataclass(frozen=True)
class Ground:
    """The lanes of a town, including those through junctions, prepared for drawing."""

    town: Town

    @cached_property
    def levels(self) -> NDArray[np.int64]:
        """int64 [lanes]: the level of each lane's middle, counted upwards."""
        graph = self.town.graph
        return level_of(graph.elevation + 0.5 * graph.grade * graph.length)

    @cached_property
    def _surfaces(self) -> list[NDArray[np.float64]]:
        """Each lane's outline, float64 [points, 2], m."""
        return outlines(self.town.lane_polylines(), self.town.graph.width)

    @cached_property
    def _marked(self) -> list[AbstractLane]:
        """Each lane as highway-env's lane, with its markings."""
        return [self.town.network.get_lane(index) for index in self.town.lane_indices]

    def visible(self, surface: WorldSurface) -> NDArray[np.int64]:
        """The lanes that may be visible, int64 [n]."""
        west, north = surface.origin
        east, south = surface.origin + np.array(surface.get_size()) / surface.scaling
        box = self.town.graph.box
        seen = (box[:, 0] <= east) & (box[:, 2] >= west) & (box[:, 1] <= south) & (box[:, 3] >= north)
        return np.flatnonzero(seen)

    def draw(self, surface: WorldSurface, lanes: NDArray[np.int64]) -> None:
        """Draw lanes: those through junctions first, so that the markings of roads are on top."""
        in_junction = self.town.graph.movement[lanes] >= 0
        for lane in lanes[in_junction].tolist():
            self._fill(surface, lane, WAY)
        for lane in lanes[~in_junction].tolist():
            self._fill(surface, lane, ASPHALT)
        for lane in lanes[~in_junction].tolist():
            LaneGraphics.display(self._marked[lane], surface)

    def _fill(self, surface: WorldSurface, lane: int, colour: tuple[int, int, int]) -> None:
        points = ((self._surfaces[lane] - surface.origin) * surface.scaling).tolist()
        pygame.draw.polygon(surface, colour, points)
        pygame.draw.polygon(surface, colour, points, 1)  # the edge too, so that lanes have no gaps


def level_of(elevation: NDArray[np.float64]) -> NDArray[np.int64]:
    """The level of each elevation (m), int64."""
    return np.round(elevation / LEVEL).astype(np.int64)
