"""What an OpenDRIVE file says, as far as lanes for driving need it.

Everything keeps the line of the file it was read from, so that an error can name the place. Coordinates and
stations are the file's: x and y in metres with y to the left of x, headings in radians and counter-clockwise,
`s` metres along a road's reference line, `t` metres to its left.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

from athrl_driving.errors import DrivingError

DRIVING_TYPES = frozenset(
    {"driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane", "mwyEntry", "mwyExit"}
)
"""Lane types that vehicles drive on; all others are left out."""


class MapError(DrivingError):
    """A map that cannot be driven on: one line that names the file, the road, the lane and the line."""


@dataclass(frozen=True, slots=True)
class Cubic:
    """A polynomial `a + b ds + c ds2 + d ds3` that holds from station `s` on."""

    s: float
    a: float
    b: float
    c: float
    d: float
    line: int

    def at(self, s: float) -> float:
        """Return the value at station `s`."""
        ds = s - self.s
        return self.a + ds * (self.b + ds * (self.c + ds * self.d))

    @property
    def is_constant(self) -> bool:
        """Whether the value is the same everywhere."""
        return self.b == 0.0 and self.c == 0.0 and self.d == 0.0


def record_at(records: Sequence[Cubic], s: float) -> Cubic | None:
    """Return the record that holds at station `s`: the last that has begun."""
    place = bisect_right(records, s + 1e-9, key=lambda record: record.s)
    return records[place - 1] if place else None


@dataclass(frozen=True, slots=True)
class Geometry:
    """A piece of a reference line; `parameters` by name, in the order of OpenDRIVE's attributes.

    `kind` is line, arc (curvature), spiral (curvStart, curvEnd), poly3 (a, b, c, d) or paramPoly3
    (aU, bU, cU, dU, aV, bV, cV, dV, and normalized: 1.0 where the parameter runs from 0 to 1).
    """

    s: float
    x: float
    y: float
    heading: float
    length: float
    kind: str
    parameters: tuple[float, ...]
    line: int


@dataclass(frozen=True, slots=True)
class LaneMark:
    """From `s` metres into the section on: may one change to the lane of the higher or the lower id?"""

    s: float
    increase: bool
    decrease: bool


@dataclass(frozen=True, slots=True)
class SpeedLimit:
    """From `s` metres into the road or the section on: m/s, or None where the file says no limit."""

    s: float
    limit: float | None


@dataclass(slots=True, eq=False)
class Lane:
    """A lane of a section; the width is given by `widths` or, where these are empty, by `borders`."""

    id: int
    type: str
    direction: str
    widths: list[Cubic]
    borders: list[Cubic]
    predecessors: list[int]
    successors: list[int]
    marks: list[LaneMark]
    speeds: list[SpeedLimit]
    line: int

    @property
    def drives(self) -> bool:
        """Whether vehicles drive on it."""
        return self.type in DRIVING_TYPES


@dataclass(slots=True, eq=False)
class LaneSection:
    """A stretch of road with the same lanes; `lanes` by id, without the centre lane."""

    s: float
    end: float
    lanes: dict[int, Lane]
    line: int


@dataclass(frozen=True, slots=True)
class RoadLink:
    """What a road's end is linked to; `contact` is "start" or "end" of a road, empty for a junction."""

    is_junction: bool
    id: str
    contact: str
    line: int


@dataclass(frozen=True, slots=True)
class Signal:
    """A traffic light beside a road; `lanes` are the ids (first, last) it holds for, empty for all."""

    id: str
    s: float
    orientation: str
    lanes: tuple[tuple[int, int], ...]
    line: int


@dataclass(slots=True, eq=False)
class Road:
    """A road: reference line, heights, lanes and what its ends are linked to."""

    id: str
    name: str
    length: float
    junction: str
    left_hand_traffic: bool
    predecessor: RoadLink | None
    successor: RoadLink | None
    speeds: list[SpeedLimit]
    geometries: list[Geometry]
    elevations: list[Cubic]
    offsets: list[Cubic]
    sections: list[LaneSection]
    signals: list[Signal]
    line: int

    @property
    def in_junction(self) -> bool:
        """Whether it is a way through a junction."""
        return self.junction != "-1"

    def drives_forward(self, lane: Lane) -> bool:
        """Tell whether vehicles on one of its lanes drive in the direction of growing stations."""
        forward = (lane.id > 0) if self.left_hand_traffic else (lane.id < 0)
        return forward != (lane.direction == "reversed")


@dataclass(frozen=True, slots=True)
class Connection:
    """A way into a junction: from a road on a connecting road, with pairs of lane ids (from, to)."""

    incoming: str
    connecting: str
    contact: str
    lane_links: tuple[tuple[int, int, int], ...]
    """(from, to, line of the file)."""
    line: int


@dataclass(slots=True, eq=False)
class JunctionRecord:
    """A junction as the file has it; `priorities` are pairs of road ids (high, low)."""

    id: str
    name: str
    connections: list[Connection]
    priorities: list[tuple[str, str]]
    controllers: list[str]
    line: int


@dataclass(slots=True, eq=False)
class OpenDrive:
    """A file's content; roads, junctions and controllers (their signals' ids) by id."""

    name: str
    roads: dict[str, Road]
    junctions: dict[str, JunctionRecord]
    controllers: dict[str, list[str]] = field(default_factory=dict)

    def error(self, road: str, lane: int | None, line: int, message: str) -> MapError:
        """Return the error for a place in the file."""
        place = f"road {road}" + (f", lane {lane}" if lane is not None else "")
        return MapError(f"{self.name}: {place}, line {line}: {message}")
