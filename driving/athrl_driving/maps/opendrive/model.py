"""What an OpenDRIVE file says, as far as driving lanes need it.

Every record keeps the line of the file it was read from, so that an error can name the place. Coordinates and
stations are the file's: x and y in metres with y to the left of x, headings in radians and counter-clockwise,
`s` metres along a road's reference line, `t` metres to its left.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

from athrl_driving.maps.findings import Findings, MapError
from athrl_driving.maps.opendrive.bounds import (
    MOST_LIGHTS,
    MOST_PIECES,
    PIECES_OF_A_ROAD,
    PIECES_PER_FORMULA,
    PIECES_PER_METRE,
)

DRIVING_TYPES = frozenset(
    {
        "driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane", "mwyEntry", "mwyExit",
        "shared",
    }
)  # fmt: skip
"""Lane types that vehicles drive on; all others are left out."""


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
class Bend:
    """How a part of a reference line is moved to meet its neighbours: by less and less towards its other end.

    `start` and `end` are (m, m) that its ends are moved by, `span` is the metres between them.
    """

    span: float
    start: tuple[float, float] = (0.0, 0.0)
    end: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Geometry:
    """A part of a reference line; `parameters` in the order of OpenDRIVE's attributes.

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
    bend: Bend | None = None
    """Where a gap beside it was bridged."""


@dataclass(frozen=True, slots=True)
class LaneMark:
    """From `s` metres into the section on: whether vehicles may change to the lane of higher or lower id."""

    s: float
    increase: bool
    decrease: bool


@dataclass(frozen=True, slots=True)
class SpeedLimit:
    """From `s` metres into the road or the section on: m/s, or None where the file gives none."""

    s: float
    limit: float | None


@dataclass(slots=True, eq=False)
class Lane:
    """A lane of a section. What its file gives by `borders` has `widths` once the whole section is read."""

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
    """A section of road with the same lanes; `lanes` by id, without the centre lane."""

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
    """A traffic light where it holds for a road, its own or one of another road that it refers to.

    `lanes` are the ids (first, last) it holds for, empty for all. `orientation` is "+" or "-" where it holds
    for the traffic along growing or falling stations only.
    """

    id: str
    s: float
    orientation: str
    lanes: tuple[tuple[int, int], ...]
    line: int

    def holds_for(self, lane: int) -> bool:
        """Tell whether it holds for the lane with this id; no lane has the id 0."""
        return not self.lanes or any(first <= lane <= last for first, last in self.lanes)


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
    """The traffic lights that hold for it."""
    line: int
    references: list[Signal] = field(default_factory=list)
    """Signals of all kinds, on any road, that hold for it too."""

    @property
    def in_junction(self) -> bool:
        """Whether it is a connecting road of a junction."""
        return self.junction != "-1"

    def drives_forward(self, lane: Lane) -> bool:
        """Tell whether vehicles on one of its lanes drive in the direction of growing stations."""
        forward = (lane.id > 0) if self.left_hand_traffic else (lane.id < 0)
        return forward != (lane.direction == "reversed")


@dataclass(frozen=True, slots=True)
class Connection:
    """A connection of a junction: from an incoming road to a connecting road, with lane ids (from, to).

    In a direct junction `connecting` is the road that the incoming road is linked to. `contact` is the end of
    it that touches the incoming road, empty where the file does not say.
    """

    incoming: str
    connecting: str
    contact: str
    lane_links: tuple[tuple[int, int, int], ...] | None
    """(from, to, line of the file); None where lanes with the same id are linked."""
    line: int


@dataclass(slots=True, eq=False)
class JunctionRecord:
    """A junction as the file has it; `priorities` are pairs of road ids (high, low)."""

    id: str
    name: str
    type: str
    """As the file has it: "direct", "virtual", "crossing"; all others are common junctions."""
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
    findings: Findings
    """Faults that did not stop the file from being read."""
    controllers: dict[str, list[str]] = field(default_factory=dict)
    other_signals: set[str] = field(default_factory=set)
    """Ids of the signals that are no traffic lights for vehicles."""
    lights: int = 0
    """Counted so far, in the unit of `MOST_LIGHTS`."""
    pieces: int = 0
    """Counted so far, in the unit of `MOST_PIECES`."""
    allowed: int = 0
    """Pieces that the road which is being cut may still have."""
    revision: str = ""
    """Of OpenDRIVE, such as "1.6"; empty where the file does not tell."""

    def begin_road(self, road: "Road", cuts: int) -> None:
        """Allow a road, which has so many formulas, as many pieces as the bends of a road can need."""
        self.allowed = PIECES_OF_A_ROAD + int(PIECES_PER_METRE * road.length) + PIECES_PER_FORMULA * cuts

    def count_piece(self, road: "Road", lanes: int) -> None:
        """Count a piece of a road with so many lanes; raises `MapError` if there are too many."""
        self.allowed -= 1
        self.pieces += lanes + 10  # what a piece takes beside its lanes
        if self.allowed < 0 or self.pieces > MOST_PIECES:
            what = (
                "it bends, rises or widens too often"
                if self.allowed < 0
                else "the map is too long up to here"
            )
            raise self.error(road.id, None, road.line, f"{what}: it would have too many pieces")

    def count_light(self, light: Signal) -> None:
        """Count a traffic light or a reference; raises `MapError` if there are too many."""
        self.lights += 1 + len(light.lanes)
        if self.lights > MOST_LIGHTS:
            what = f"more than {MOST_LIGHTS:,} traffic lights, references to signals and ranges of lanes"
            raise MapError(f"{self.name}: line {light.line}: it has {what} up to here")

    def error(self, road: str, lane: int | None, line: int, message: str) -> MapError:
        """Return the error for a place in the file."""
        return MapError(f"{self.name}: {_place(road, lane, line)}: {message}")

    def note(self, kind: str, road: str, lane: int | None, line: int, metres: float | None = None) -> None:
        """Note a fault at a place in the file. Raises `MapError` where the file is read strictly."""
        self.findings.add(kind, _place(road, lane, line), metres)


def _place(road: str, lane: int | None, line: int) -> str:
    return f"road {road}, line {line}" if lane is None else f"road {road}, lane {lane}, line {line}"
