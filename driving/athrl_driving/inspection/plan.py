"""A sheet to draw a plan on: metres in, pixels out, smooth edges, a title, a scale and a legend.

pygame draws without smoothing, so everything but text is drawn twice as large and shrunk at the end.
"""

from __future__ import annotations

import math

import numpy as np
import pygame
from athrl_spaces.untrusted import one_line
from numpy.typing import NDArray

Colour = tuple[int, int, int]

_PAPER, _INK = (248, 248, 245), (40, 44, 52)
_LARGEST = 1400
"""Pixels of the longer side of what is drawn."""
_SHORTEST = 700
"""Pixels of either side at least, so that title and legend fit."""
_FINER = 2
"""Pixels that are drawn for one of the picture, along each side."""
_MARGIN, _HEAD, _FOOT = 30, 60, 60
_TEXT, _TITLE = 22, 30
_GAP = 10
_MARK = 0.25
"""Metres: the width of a mark on the road."""
_LONGEST_SCALE = 200.0
"""Pixels; a round number of metres is at least 0.4 of it."""


class Plan:
    """A picture of a rectangle of the ground, with x to the right and y downwards, as towns have them."""

    def __init__(self, points: NDArray[np.float64]) -> None:
        """Make a sheet on which all points, [n, 2] in metres, find a place."""
        self._low, high = points.min(axis=0), points.max(axis=0)
        extent = np.maximum(high - self._low, 1.0)
        self._scale = _LARGEST / float(extent.max())
        """Pixels a metre."""
        drawn = extent * self._scale
        self._size = np.maximum(np.ceil(drawn), _SHORTEST).astype(int)
        self._shift = 0.5 * (self._size - drawn) + (_MARGIN, _HEAD)
        width, height = self._size.tolist()
        fine = (_FINER * (width + 2 * _MARGIN), _FINER * (height + _HEAD + _FOOT))
        self.surface = pygame.Surface(fine)
        self.surface.fill(_PAPER)

    @property
    def least_width(self) -> float:
        """Return how wide something must be to be seen well, m."""
        return 1.5 / self._scale

    @property
    def spacing(self) -> float:
        """Return how far apart points of a line may be, m, so that no corners are seen in a bend."""
        return min(2.0, 4.0 / self._scale)

    def pixels(self, metres: float) -> float:
        """Return how long a length is in the picture."""
        return metres * self._scale

    def pixel(self, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where points, [.., 2] in metres, are in the picture: [.., 2] in pixels."""
        return (point - self._low) * self._scale + self._shift

    def area(self, outline: NDArray[np.float64], colour: Colour) -> None:
        """Fill an outline, [n, 2] in metres; its edge too, so that thin lanes and neighbours have no gaps."""
        points = self._fine(outline)
        pygame.draw.polygon(self.surface, colour, points)
        pygame.draw.polygon(self.surface, colour, points, 1)

    def line(self, points: NDArray[np.float64], colour: Colour) -> None:
        """Draw a line through points, [n, 2] in metres, as thin as a mark on the road."""
        width = min(max(1, round(_MARK * self._scale * _FINER)), 2 * _FINER)
        pygame.draw.lines(self.surface, colour, False, self._fine(points), width)

    def dot(self, place: NDArray[np.float64], colour: Colour) -> None:
        """Draw a dot at a place, [2] in metres."""
        centre = self._fine(place)
        pygame.draw.circle(self.surface, _PAPER, centre, 6 * _FINER)
        pygame.draw.circle(self.surface, colour, centre, 5 * _FINER)

    def arrow(self, place: NDArray[np.float64], ahead: NDArray[np.float64], colour: Colour) -> None:
        """Draw the head of an arrow at a place, [2] in metres, that points along `ahead`, [2]."""
        along = ahead / max(float(np.hypot(*ahead)), 1e-9)
        across = np.array([-along[1], along[0]])
        tip = 4.0 * _FINER * along
        corners = [tip, 2.5 * _FINER * across - tip, -0.5 * tip, -2.5 * _FINER * across - tip]
        centre = self.pixel(place) * _FINER
        pygame.draw.polygon(self.surface, colour, [(centre + corner).tolist() for corner in corners])

    def finish(self, title: str, legend: list[tuple[str, Colour]]) -> None:
        """Shrink the picture to its size and write the title above and the legend and a scale below."""
        width, height = (length // _FINER for length in self.surface.get_size())
        self.surface = pygame.transform.smoothscale(self.surface, (width, height))
        self._write(title, _MARGIN, _HEAD // 2, _TITLE)
        base, x = height - _FOOT // 2, self._draw_scale(_MARGIN, height - _FOOT // 2)
        for name, colour in legend:
            pygame.draw.rect(self.surface, colour, (x, base - 7, 26, 14), border_radius=3)
            x = self._write(name, x + 26 + _GAP, base, _TEXT) + 2 * _GAP

    def _draw_scale(self, x: int, y: int) -> int:
        """Draw a bar of a round number of metres, and return where the next thing may be, pixels."""
        metres = _round_length(_LONGEST_SCALE / self._scale)
        length = round(metres * self._scale)
        pygame.draw.lines(
            self.surface, _INK, False, [(x, y - 6), (x, y), (x + length, y), (x + length, y - 6)], 2
        )
        return self._write(f"{metres:g} m", x + length + _GAP, y, _TEXT) + 3 * _GAP

    def _write(self, text: str, x: int, y: int, size: int) -> int:
        """Write a text from `x` on, its middle at the height `y`; return where it ends, pixels."""
        pygame.font.init()
        rendered = pygame.font.Font(None, size).render(one_line(text), True, _INK)
        self.surface.blit(rendered, (x, y - rendered.get_height() // 2))
        return x + rendered.get_width()

    def _fine(self, point: NDArray[np.float64]) -> list:
        return (self.pixel(point) * _FINER).tolist()


def _round_length(metres: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a length."""
    power = 10.0 ** math.floor(math.log10(metres))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= metres)
