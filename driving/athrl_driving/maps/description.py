"""The words a town is described in: nodes and the roads between them.

A description is short enough to be read at one glance; `builder` turns it into lanes. Coordinates are metres
in highway-env's frame: x to the right, y downwards on the screen, headings in radians, growing clockwise.
"""

from dataclasses import dataclass

TOWN_SPEED = 30.0 / 3.6
"""Speed limit in the streets, m/s (30 km/h)."""

BOULEVARD_SPEED = 50.0 / 3.6
"""Speed limit where there are two lanes in each direction, m/s (50 km/h)."""


@dataclass(frozen=True)
class Node:
    """Where roads meet: a junction, or a roundabout of `ring_radius` (m, to the middle of its lane)."""

    name: str
    x: float
    y: float
    ring_radius: float = 0.0


@dataclass(frozen=True)
class Bend:
    """A corner of a road between its nodes, rounded with an arc of `radius` metres (in the road's middle)."""

    x: float
    y: float
    radius: float


@dataclass(frozen=True)
class Street:
    """A road from one node to another with the same number of lanes in both directions."""

    start: str
    end: str
    bends: tuple[Bend, ...] = ()
    lanes: int = 1
    speed_limit: float = TOWN_SPEED


@dataclass(frozen=True)
class TownDescription:
    """A whole town. `lane_width` is in metres."""

    name: str
    nodes: tuple[Node, ...]
    streets: tuple[Street, ...]
    lane_width: float = 3.5
