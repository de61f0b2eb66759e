"""A town while it is being laid: OpenDRIVE's roads, lanes, junctions and signals as plain objects.

Lanes are numbered as in OpenDRIVE: negative to the right of the reference line, positive to its left,
counting outwards. `opendrive` writes a plan to a file.
"""

import itertools
from dataclasses import dataclass, field
from typing import Literal

from athrl_driving.maps.making.curves import Piece, Pose, length_of

Contact = Literal["start", "end"]


@dataclass(frozen=True)
class LanePlan:
    """One lane of a section, between `width` metres at its start and `end_width` at its end."""

    number: int
    kind: str
    width: float
    mark: str = "none"
    change: str = "none"
    end_width: float | None = None
    predecessor: int | None = None
    successor: int | None = None


@dataclass
class SectionPlan:
    """Lanes from station `start` (m) on; `centre_mark` is the mark on the reference line."""

    start: float
    lanes: list[LanePlan]
    centre_mark: str = "none"


@dataclass(frozen=True)
class SignalPlan:
    """A traffic light for all lanes that drive towards one end of a road."""

    number: int
    name: str
    position: float
    lateral: float
    orientation: Literal["+", "-"]
    from_lane: int
    to_lane: int


@dataclass
class RoadPlan:
    """One OpenDRIVE road; `lane_offset` (m, to the left) shifts its lanes off the reference line."""

    number: int
    name: str
    kind: str
    mph: int
    pieces: list[Piece]
    sections: list[SectionPlan]
    lane_offset: float = 0.0
    junction: int = -1
    predecessor: tuple[str, int, Contact | None] | None = None
    successor: tuple[str, int, Contact | None] | None = None
    elevation: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    signals: list[SignalPlan] = field(default_factory=list)

    @property
    def length(self) -> float:
        """Length of the reference line, m."""
        return length_of(self.pieces)


@dataclass(frozen=True)
class LaneEnd:
    """One driving lane where it meets a junction, with the pose of its middle in driving direction."""

    road: RoadPlan
    contact: Contact
    number: int
    pose: Pose


@dataclass
class Arm:
    """A road where it meets a node: its lanes (from the driver's left) in and out.

    `direction` is the road's, seen from the node; `half_width` (m) reaches to its outermost lane's middle.
    """

    incoming: list[LaneEnd]
    outgoing: list[LaneEnd]
    direction: float
    half_width: float
    major: bool = False


@dataclass(frozen=True)
class ConnectionPlan:
    """A connecting road of one lane through a junction."""

    incoming: LaneEnd
    outgoing: LaneEnd
    road: RoadPlan


@dataclass
class JunctionPlan:
    """A junction; `priorities` are pairs of connecting roads of which the second gives way to the first."""

    number: int
    name: str
    connections: list[ConnectionPlan] = field(default_factory=list)
    priorities: list[tuple[int, int]] = field(default_factory=list)
    controllers: list[int] = field(default_factory=list)


@dataclass
class ControllerPlan:
    """Traffic lights that are green together."""

    number: int
    name: str
    signals: list[int]


@dataclass
class TownPlan:
    """All that has been laid so far, and the numbers that come next."""

    name: str
    lane_width: float
    roads: list[RoadPlan] = field(default_factory=list)
    junctions: list[JunctionPlan] = field(default_factory=list)
    controllers: list[ControllerPlan] = field(default_factory=list)
    _road_numbers: "itertools.count[int]" = field(default_factory=lambda: itertools.count(1))
    _connection_numbers: "itertools.count[int]" = field(default_factory=lambda: itertools.count(1001))
    _signal_numbers: "itertools.count[int]" = field(default_factory=lambda: itertools.count(1))

    def add_road(
        self, name: str, kind: str, mph: int, pieces: list[Piece], sections: list[SectionPlan], offset: float
    ) -> RoadPlan:
        """Add an ordinary road and return it."""
        road = RoadPlan(next(self._road_numbers), name, kind, mph, pieces, sections, offset)
        self.roads.append(road)
        return road

    def add_junction(self, name: str) -> JunctionPlan:
        """Add a junction and return it."""
        junction = JunctionPlan(101 + len(self.junctions), name)
        self.junctions.append(junction)
        return junction

    def connect(
        self, junction: JunctionPlan, incoming: LaneEnd, outgoing: LaneEnd, pieces: list[Piece]
    ) -> RoadPlan:
        """Add a connecting road of one lane, whose middle is `pieces`, and return it."""
        lane = LanePlan(
            -1, "driving", self.lane_width, predecessor=incoming.number, successor=outgoing.number
        )
        road = RoadPlan(
            next(self._connection_numbers),
            junction.name,
            incoming.road.kind,
            min(incoming.road.mph, outgoing.road.mph),
            pieces,
            [SectionPlan(0.0, [lane])],
            lane_offset=self.lane_width / 2.0,
            junction=junction.number,
            predecessor=("road", incoming.road.number, incoming.contact),
            successor=("road", outgoing.road.number, outgoing.contact),
        )
        self.roads.append(road)
        junction.connections.append(ConnectionPlan(incoming, outgoing, road))
        _link_to_junction(incoming, junction)
        _link_to_junction(outgoing, junction)
        return road

    def add_signal(self, name: str, arm: Arm) -> int:
        """Put a traffic light at the stop line of an arm and return its number."""
        number = next(self._signal_numbers)
        road, contact = arm.incoming[0].road, arm.incoming[0].contact
        forward = contact == "end"
        numbers = sorted(lane.number for lane in arm.incoming)
        lateral = (arm.half_width + self.lane_width / 2.0 + 0.5) * (-1.0 if forward else 1.0)
        position = road.length - 0.5 if forward else 0.5
        signal = SignalPlan(number, name, position, lateral, "+" if forward else "-", numbers[0], numbers[-1])
        road.signals.append(signal)
        return number


def _link_to_junction(lane: LaneEnd, junction: JunctionPlan) -> None:
    if lane.contact == "start":
        lane.road.predecessor = ("junction", junction.number, None)
    else:
        lane.road.successor = ("junction", junction.number, None)
