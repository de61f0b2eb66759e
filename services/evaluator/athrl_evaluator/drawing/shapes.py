"""Points and outlines in the two pictures: the town in its coordinates, the surroundings with heading up."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from athrl_protocol import Point, Vehicle


class CarPicture:
    """Turns town coordinates into the picture around the car: x to its right, y behind it (y grows down)."""

    def __init__(self, ego: Vehicle) -> None:
        self._origin = np.array([ego.x, ego.y])
        cosine, sine = np.cos(ego.heading), np.sin(ego.heading)
        self._turn = np.array([[-sine, cosine], [-cosine, -sine]])

    def points(self, points: np.ndarray) -> np.ndarray:
        """Town points float64 [n, 2], m, in the picture: float64 [n, 2], m."""
        return (points - self._origin) @ self._turn.T


def points_of(points: Iterable[Point]) -> np.ndarray:
    """Points as float64 [n, 2]."""
    return np.array([(point.x, point.y) for point in points], np.float64).reshape(-1, 2)


def outlines_of(vehicles: Sequence[Vehicle]) -> np.ndarray:
    """Closed outlines of vehicles, float64 [n, 5, 2], m in the town."""
    corners = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1), (1, 1)]) / 2
    return _in_town(vehicles, corners)


def bodies_of(vehicles: Sequence[Vehicle]) -> np.ndarray:
    """Lines that, drawn as wide as a vehicle, fill it with round ends: float64 [n, 2, 2], m in the town."""
    lines = _in_town(vehicles, np.array([(-1, 0), (1, 0)]) / 2)
    lengths = np.array([(each.length, each.width) for each in vehicles]).reshape(-1, 2)
    shortened = 1 - lengths[:, 1] / np.maximum(lengths.max(1, initial=1e-6), 1e-6)
    middles = lines.mean(1, keepdims=True)
    return middles + (lines - middles) * shortened[:, None, None]


def windscreens_of(vehicles: Sequence[Vehicle]) -> np.ndarray:
    """A line across each vehicle near its front, to show its direction: float64 [n, 2, 2], m in the town."""
    return _in_town(vehicles, np.array([(0.22, -0.38), (0.22, 0.38)]))


def painted(channels: np.ndarray, colours: Sequence[tuple[int, int, int]]) -> np.ndarray:
    """Channels uint8 [H, W, n] painted over each other, each in its colour: uint8 [H, W, 3]."""
    picture = np.zeros((*channels.shape[:2], 3))
    for channel, colour in enumerate(colours):
        cover = channels[:, :, channel, None] / 255
        picture = picture * (1 - cover) + np.array(colour) * cover
    return picture.astype(np.uint8)


def _in_town(vehicles: Sequence[Vehicle], shape: np.ndarray) -> np.ndarray:
    """A shape [k, 2] in vehicle lengths and widths, at each vehicle: float64 [n, k, 2]."""
    rows = [(each.x, each.y, each.heading, each.length, each.width) for each in vehicles]
    x, y, heading, length, width = np.array(rows, np.float64).reshape(-1, 5).T
    along, across = length[:, None] * shape[:, 0], width[:, None] * shape[:, 1]
    cosine, sine = np.cos(heading)[:, None], np.sin(heading)[:, None]
    return np.stack(
        [x[:, None] + along * cosine - across * sine, y[:, None] + along * sine + across * cosine], -1
    )
