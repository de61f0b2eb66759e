"""Lay a motorway's carriageway: a closed ring of one-way roads between gores, where ramps leave and join."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from athrl_driving.maps.making.curves import Piece, Pose, cut, join, length_of, rounded_polyline
from athrl_driving.maps.making.description import Bridge, Gore, Motorway
from athrl_driving.maps.making.plan import Arm, LaneEnd, LanePlan, RoadPlan, SectionPlan, TownPlan

GORE_LENGTH = 40.0
"""Metres of motorway over which a ramp and the outermost lane part or meet."""

_RAMP_SMALLEST_RADIUS = 40.0
_RAMP_ASIDE = 6.5
"""Metres between the middles of the outermost lane and of the ramp where the gore ends."""

_SHOULDER = 2.5
_TAPER = 40.0
_LEAST_ROAD = 25.0
"""Metres of ordinary motorway between two gores, beside an acceleration lane."""


@dataclass(frozen=True)
class RampEnd:
    """The end of a ramp at a motorway: where it is, and the lane that it leads from or to."""

    x: float
    y: float
    motorway: str
    leaves: bool
    lane: LaneEnd
    through: tuple[tuple[LaneEnd, LaneEnd, tuple[Piece, ...]], ...]


def lay_motorway(plan: TownPlan, motorway: Motorway) -> dict[str, RampEnd]:
    """Add a motorway's roads; return the ends of its ramps by the gores' names.

    Raises `ValueError` where two gores, or a gore and a bridge, are too close to each other.
    """
    ring = _closed_line(motorway)
    around = length_of(ring)
    gores = sorted(motorway.gores, key=lambda gore: _station(ring, gore))
    stations = [_station(ring, gore) for gore in gores]
    roads = []
    for index, gore in enumerate(gores):
        start = stations[index] + GORE_LENGTH
        end = stations[index] + ((stations[(index + 1) % len(gores)] - stations[index]) % around or around)
        needed = _LEAST_ROAD + (0.0 if gore.leaves else motorway.acceleration_lane + _TAPER)
        if end - start < needed:
            raise ValueError(f"gore {gore.name}: {end - start:.0f} m to the next gore, {needed:.0f} m needed")
        pieces = cut([*ring, *ring], start, end)
        road = plan.add_road(
            motorway.name, "motorway", motorway.mph, pieces, _sections(plan, motorway, gore), 0.0
        )
        for bridge in motorway.bridges:
            middle = (_station(ring, bridge) - start) % around
            if middle < end - start:
                road.elevation = _elevation(bridge, middle, road, motorway)
        roads.append(road)
    if sum(bool(road.elevation) for road in roads) < len(motorway.bridges):
        raise ValueError(f"motorway {motorway.name}: a bridge lies on a gore or beside another bridge")
    return {
        gore.name: _ramp_end(plan, motorway, gore, stations[index], ring, roads[index - 1], roads[index])
        for index, gore in enumerate(gores)
    }


def lay_ramp_junctions(plan: TownPlan, arms: dict[str, list[Arm]], places: Mapping[str, object]) -> None:
    """Add the junctions at the gores: the motorway's lanes go on, the ramp leaves or joins.

    Raises `ValueError` where a gore has not exactly one ramp.
    """
    for name, place in places.items():
        if not isinstance(place, RampEnd):
            continue
        if len(arms[name]) != 1:
            raise ValueError(f"gore {name}: {len(arms[name])} ramps, not 1")
        junction = plan.add_junction(name)
        for start, end, pieces in place.through:
            plan.connect(junction, start, end, list(pieces))
        ramp = (arms[name][0].outgoing if place.leaves else arms[name][0].incoming)[0]
        start, end = (place.lane, ramp) if place.leaves else (ramp, place.lane)
        try:
            pieces = tuple(join(start.pose, end.pose, _RAMP_SMALLEST_RADIUS))
        except ValueError as error:
            raise ValueError(f"gore {name}: {error}") from None
        plan.connect(junction, start, end, list(pieces))


def _closed_line(motorway: Motorway) -> list[Piece]:
    corners = motorway.corners
    x, y = (corners[-1].x + corners[0].x) / 2.0, (corners[-1].y + corners[0].y) / 2.0
    return rounded_polyline(
        [(x, y, 0.0), *((corner.x, corner.y, corner.radius) for corner in corners), (x, y, 0.0)]
    )


def _station(ring: list[Piece], beside: Gore | Bridge) -> float:
    """Return the position along the ring (m) of the point of its straight parts nearest to a place."""
    position, choices = 0.0, []
    for piece in ring:
        if piece.curvature == 0.0:
            dx, dy = beside.x - piece.start.x, beside.y - piece.start.y
            along = dx * math.cos(piece.start.heading) + dy * math.sin(piece.start.heading)
            along = min(max(along, 0.0), piece.length)
            nearest = piece.at(along)
            choices.append((math.hypot(nearest.x - beside.x, nearest.y - beside.y), position + along))
        position += piece.length
    return min(choices)[1]


def _sections(plan: TownPlan, motorway: Motorway, gore: Gore) -> list[SectionPlan]:
    """Return the lanes after a gore: with an acceleration lane that ends where a ramp joins."""
    width, count = plan.lane_width, motorway.lanes
    ordinary = _section(0.0, count, width, _SHOULDER)
    if gore.leaves:
        return [ordinary]
    end = motorway.acceleration_lane
    return [
        _section(0.0, count + 1, width, _SHOULDER, linked="after"),
        _section(end, count, width, width + _SHOULDER, linked="both", shoulder_end=_SHOULDER),
        _section(end + _TAPER, count, width, _SHOULDER, linked="before"),
    ]


def _section(
    start: float,
    count: int,
    width: float,
    shoulder: float,
    linked: str = "",
    shoulder_end: float | None = None,
) -> SectionPlan:
    """Return a section of `count` lanes; the outermost lane of the one with an acceleration lane ends."""
    through = count - 1 if linked == "after" else count
    lanes = []
    for lane in range(1, count + 1):
        inner = lane < count
        lanes.append(
            LanePlan(
                -lane,
                "driving",
                width,
                mark="broken" if inner else "solid",
                change="both" if inner else "none",
                predecessor=-lane if linked in ("before", "both") else None,
                successor=-lane if linked in ("after", "both") and lane <= through else None,
            )
        )
    lanes.append(LanePlan(-count - 1, "shoulder", shoulder, end_width=shoulder_end))
    return SectionPlan(start, lanes, "solid")


def _elevation(
    bridge: Bridge, middle: float, road: RoadPlan, motorway: Motorway
) -> list[tuple[float, float, float, float, float]]:
    """Return cubics that rise to the deck and fall again, level at all ends."""
    height, slope = bridge.height, bridge.slope
    start, end = middle - bridge.deck / 2.0 - slope, middle + bridge.deck / 2.0 + slope
    if start < 1.0 or end > road.length - 1.0:
        raise ValueError(f"motorway {motorway.name}: no room for the bridge at ({bridge.x}, {bridge.y})")
    square, cube = 3.0 * height / slope**2, -2.0 * height / slope**3
    return [
        (0.0, 0.0, 0.0, 0.0, 0.0),
        (start, 0.0, 0.0, square, cube),
        (start + slope, height, 0.0, 0.0, 0.0),
        (end - slope, height, 0.0, -square, -cube),
        (end, 0.0, 0.0, 0.0, 0.0),
    ]


def _ramp_end(
    plan: TownPlan,
    motorway: Motorway,
    gore: Gore,
    station: float,
    ring: list[Piece],
    before: RoadPlan,
    after: RoadPlan,
) -> RampEnd:
    width, count = plan.lane_width, motorway.lanes
    first, last = before.pieces[-1].end, after.pieces[0].start
    gap = cut([*ring, *ring], station, station + GORE_LENGTH)
    through = []
    for index in range(count):
        lateral = -(index + 0.5) * width
        start = LaneEnd(before, "end", -index - 1, first.beside(lateral))
        end = LaneEnd(after, "start", -index - 1, last.beside(lateral))
        through.append((start, end, tuple(_beside(piece, lateral) for piece in gap)))
    lane, corner = through[-1][0], last
    if not gore.leaves:
        pose = last.beside(-(count + 0.5) * width)
        lane, corner = LaneEnd(after, "start", -count - 1, pose), first
    point = corner.beside(-((count - 0.5) * width + _RAMP_ASIDE))
    return RampEnd(point.x, point.y, motorway.name, gore.leaves, lane, tuple(through))


def _beside(piece: Piece, lateral: float) -> Piece:
    stretch = 1.0 - lateral * piece.curvature
    start: Pose = piece.start.beside(lateral)
    return Piece(start, piece.curvature / stretch, piece.length * stretch)
