"""From a town's description to its plan: trim the roads at the nodes, lay their lanes, connect them."""

import math

from athrl_driving.maps.making.curves import Piece, Pose, cut, length_of, rounded_polyline, wrap
from athrl_driving.maps.making.description import Bend, Node, Road, Roundabout, Town
from athrl_driving.maps.making.junctions import lay_junction
from athrl_driving.maps.making.motorway import RampEnd, lay_motorway, lay_ramp_junctions
from athrl_driving.maps.making.plan import Arm, Contact, LaneEnd, LanePlan, RoadPlan, SectionPlan, TownPlan
from athrl_driving.maps.making.roundabout import ARM_REACH, lay_roundabout

_SIDEWALK = 2.0
_LEAST_STRAIGHT = 1.0
"""Metres of a road that have to be straight before its stop line."""

_LEAST_ANGLE = math.radians(30.0)
_TURN_BELOW = math.radians(160.0)

Place = Node | Roundabout | RampEnd


def lay_town(town: Town) -> TownPlan:
    """Lay all roads and junctions of a town.

    Raises `ValueError` that names the road or node where the description cannot be built.
    """
    plan = TownPlan(town.name, town.lane_width)
    places: dict[str, Place] = {node.name: node for node in town.nodes}
    for motorway in town.motorways:
        places |= lay_motorway(plan, motorway)
    lines = {road: _middle(road, places) for road in town.roads}
    setbacks = _setbacks(town, lines)
    arms: dict[str, list[Arm]] = {name: [] for name in places}
    for road, line in lines.items():
        _lay_road(plan, road, line, setbacks, arms)
    for name, place in places.items():
        if isinstance(place, RampEnd):
            continue
        if isinstance(place, Roundabout):
            lay_roundabout(plan, place, arms[name])
        else:
            lay_junction(plan, place, arms[name])
    lay_ramp_junctions(plan, arms, places)
    return plan


def _middle(road: Road, places: dict[str, Place]) -> list[Piece]:
    for name in (road.start, road.end):
        if name not in places:
            raise ValueError(f"road {road.start} - {road.end}: there is no node named {name}")
    start, end = places[road.start], places[road.end]
    bends = (Bend(start.x, start.y, 0.0), *road.bends, Bend(end.x, end.y, 0.0))
    try:
        return rounded_polyline([(bend.x, bend.y, bend.radius) for bend in bends])
    except ValueError as error:
        raise ValueError(f"road {road.start} - {road.end}: {error}") from None


def _setbacks(town: Town, lines: dict[Road, list[Piece]]) -> dict[str, float]:
    """Return how far from each node's centre (m) its roads end."""
    result: dict[str, float] = {}
    for node in town.nodes:
        arms = []
        for road, line in lines.items():
            half_width = (sum(road.lanes) - 1) * town.lane_width / 2.0
            if road.start == node.name:
                arms.append((wrap(line[0].start.heading), half_width))
            if road.end == node.name:
                arms.append((wrap(line[-1].end.heading + math.pi), half_width))
        if len(arms) < 3:
            raise ValueError(f"node {node.name}: {len(arms)} roads meet there, a junction needs at least 3")
        if isinstance(node, Roundabout):
            result[node.name] = node.radius + ARM_REACH
        else:
            result[node.name] = _junction_room(node, arms)
    return result


def _junction_room(node: Node, arms: list[tuple[float, float]]) -> float:
    """Return the metres that right turns need between arms, given as direction and half width."""
    radius = node.turn_radius
    room = radius
    arms = sorted(arms)
    for first, second in zip(arms, arms[1:] + arms[:1], strict=True):
        angle = (second[0] - first[0]) % (2.0 * math.pi)
        if angle < _LEAST_ANGLE:
            raise ValueError(f"node {node.name}: two roads are only {math.degrees(angle):.0f} degrees apart")
        if angle < _TURN_BELOW:
            # The outer lanes' lines meet there; the turn's tangent begins before.
            room = max(room, (max(first[1], second[1]) + radius) / math.tan(angle / 2.0))
    return room


def _lay_road(
    plan: TownPlan,
    road: Road,
    line: list[Piece],
    setbacks: dict[str, float],
    arms: dict[str, list[Arm]],
) -> None:
    name = road.name or f"{road.start} - {road.end}"
    # A ramp's end at a motorway is where it was described; only nodes need room.
    start, end = setbacks.get(road.start, 0.0), setbacks.get(road.end, 0.0)
    for piece, room in ((line[0], start), (line[-1], end)):
        if piece.curvature != 0.0 or piece.length < room + _LEAST_STRAIGHT:
            raise ValueError(f"road {name}: it must be straight for {room + _LEAST_STRAIGHT:.1f} m at a node")
    length = length_of(line)
    if length < start + end + _LEAST_STRAIGHT:
        raise ValueError(f"road {name}: it has {length:.1f} m, its nodes need {start + end:.1f} m")
    pieces = cut(line, start, length - end)
    forth, back = road.lanes
    width = plan.lane_width
    offset = (forth - back) * width / 2.0
    laid = plan.add_road(name, "town", road.mph, pieces, [_cross_section(road, width)], offset)
    half_width = (forth + back - 1) * width / 2.0
    first, last = pieces[0].start, pieces[-1].end
    here, there = _lane_ends(laid, "start", first, road, width), _lane_ends(laid, "end", last, road, width)
    arms[road.start].append(Arm(here[1], here[0], wrap(first.heading), half_width, road.major))
    arms[road.end].append(Arm(there[0], there[1], wrap(last.heading + math.pi), half_width, road.major))


def _cross_section(road: Road, width: float) -> SectionPlan:
    forth, back = road.lanes
    lanes = []
    for sign, count in ((-1, forth), (1, back)):
        for index in range(count):
            inner = index < count - 1
            lanes.append(
                LanePlan(
                    sign * (index + 1),
                    "driving",
                    width,
                    mark="broken" if inner else "solid",
                    change="both" if inner else "none",
                )
            )
        if count and back:
            lanes.append(LanePlan(sign * (count + 1), "sidewalk", _SIDEWALK))
    return SectionPlan(0.0, lanes, centre_mark="broken" if forth == back == 1 else "solid")


def _lane_ends(
    laid: RoadPlan, contact: Contact, pose: Pose, road: Road, width: float
) -> tuple[list[LaneEnd], list[LaneEnd]]:
    """Return the lanes that lead forth and those that lead back, from the driver's left, at a road's end."""
    forth = [
        LaneEnd(laid, contact, -index - 1, pose.beside(laid.lane_offset - (index + 0.5) * width))
        for index in range(road.lanes[0])
    ]
    back = [
        LaneEnd(laid, contact, index + 1, pose.beside(laid.lane_offset + (index + 0.5) * width).turned_back())
        for index in range(road.lanes[1])
    ]
    return forth, back
