"""The words a town is described in: nodes, the roads between them, motorways round them.

A description is short enough to be read at one glance; `laying` turns it into OpenDRIVE roads. Coordinates
are metres in OpenDRIVE's frame: x to the right (east), y upwards (north).
"""

from dataclasses import dataclass

TURN_RADIUS = 8.2
"""Metres: right turns at a junction are made this wide. A car of 4.9 m that steers 21 degrees needs 7.6."""


@dataclass(frozen=True)
class Node:
    """Where roads meet at a level: a junction of three arms or more.

    With `signals` the arms that lie opposite each other have green together. The middle of a lane that turns
    right has `turn_radius` metres.
    """

    name: str
    x: float
    y: float
    signals: bool = False
    turn_radius: float = TURN_RADIUS


@dataclass(frozen=True)
class Roundabout:
    """A ring of two lanes, driven counter-clockwise, of `radius` (m, to the line between its lanes)."""

    name: str
    x: float
    y: float
    radius: float


@dataclass(frozen=True)
class Bend:
    """A corner of a road between its nodes, rounded with an arc of `radius` metres (in the road's middle)."""

    x: float
    y: float
    radius: float


@dataclass(frozen=True)
class Road:
    """A road from one node to another.

    `lanes` are those from `start` to `end` and those back, 0 on a one-way road. Where `major` roads and
    others meet, the others give way. `start` and `end` may be gores of a motorway, then it is a ramp.
    """

    start: str
    end: str
    bends: tuple[Bend, ...] = ()
    lanes: tuple[int, int] = (1, 1)
    mph: int = 30
    major: bool = False
    name: str = ""


@dataclass(frozen=True)
class Gore:
    """Where a ramp leaves (`leaves`) or joins a motorway; (x, y) is a point beside it."""

    name: str
    x: float
    y: float
    leaves: bool


@dataclass(frozen=True)
class Bridge:
    """Where a motorway rises to pass over a road; (x, y) is a point beside its middle. Lengths in metres."""

    x: float
    y: float
    height: float
    deck: float
    slope: float


@dataclass(frozen=True)
class Motorway:
    """A carriageway that is a closed ring through rounded `corners`, driven in their order.

    `corners` give its left edge; its lanes lie to the right. Where a ramp joins, an acceleration lane of
    `acceleration_lane` metres runs beside the others and ends.
    """

    name: str
    corners: tuple[Bend, ...]
    lanes: int
    mph: int
    gores: tuple[Gore, ...]
    bridges: tuple[Bridge, ...] = ()
    acceleration_lane: float = 150.0


@dataclass(frozen=True)
class Town:
    """A whole town. `lane_width` in metres."""

    name: str
    nodes: tuple[Node | Roundabout, ...]
    roads: tuple[Road, ...]
    motorways: tuple[Motorway, ...] = ()
    lane_width: float = 3.5
