"""A roundabout with two lanes: driven counter-clockwise, the ring has priority over its entries.

Round the ring, sections and arms alternate. Each arm is a junction of its own: the entry from the road, the
way past the arm on the ring, and the exit to the road. A section between two arms is an ordinary road.
"""

import math

from athrl_driving.maps.making.curves import Piece, Pose, join
from athrl_driving.maps.making.description import Roundabout
from athrl_driving.maps.making.plan import Arm, LaneEnd, LanePlan, RoadPlan, SectionPlan, TownPlan

ARM_REACH = 9.5
"""Metres from the line between the ring's lanes to where the roads end."""

MERGE_ANGLE = math.radians(27.5)
"""Angle on the ring between an arm's axis and the points where its exit leaves and its entry joins."""

_SMALLEST_RADIUS = 8.0
"""Metres: no entry and no exit is tighter."""

_LANES = 2
_LEAST_SECTION = 12.0
"""Metres of a section's inner lane: on less a vehicle that waits for its exit would block an entry."""

_MPH = 20


def lay_roundabout(plan: TownPlan, node: Roundabout, arms: list[Arm]) -> None:
    """Add the ring, entries and exits.

    Raises `ValueError` where two arms are too close to each other or an arm has not two lanes in and out.
    """
    order = sorted(arms, key=lambda arm: arm.direction)
    for arm in order:
        if len(arm.incoming) != _LANES or len(arm.outgoing) != _LANES:
            raise ValueError(f"node {node.name}: every road at a roundabout needs {_LANES} lanes in and out")
    sections = [
        _lay_section(plan, node, arm.direction, following.direction)
        for arm, following in zip(order, order[1:] + order[:1], strict=True)
    ]
    for index, arm in enumerate(order):
        junction = plan.add_junction(f"{node.name} {index + 1}")
        before, after = sections[index - 1], sections[index]
        ring = []
        for lane in range(_LANES):
            start, end = _ring_lane(before, "end", lane), _ring_lane(after, "start", lane)
            radius = node.radius + (lane - 0.5) * plan.lane_width
            past = Piece(start.pose, 1.0 / radius, 2.0 * MERGE_ANGLE * radius)
            ring.append(plan.connect(junction, start, end, [past]))
            leaving = join(start.pose, arm.outgoing[lane].pose, _SMALLEST_RADIUS)
            ring.append(plan.connect(junction, start, arm.outgoing[lane], leaving))
        entries = []
        for lane in range(_LANES):
            end = _ring_lane(after, "start", lane)
            entering = join(arm.incoming[lane].pose, end.pose, _SMALLEST_RADIUS)
            entries.append(plan.connect(junction, arm.incoming[lane], end, entering))
        junction.priorities = [(high.number, low.number) for high in ring for low in entries]


def _lay_section(plan: TownPlan, node: Roundabout, arm: float, following: float) -> RoadPlan:
    """Add the part of the ring between two arms' directions."""
    angle = arm + MERGE_ANGLE
    span = (following - MERGE_ANGLE - angle) % (2.0 * math.pi)
    inner = span * (node.radius - plan.lane_width / 2.0)
    if not _LEAST_SECTION <= inner < 1.5 * math.pi * node.radius:
        raise ValueError(f"node {node.name}: {inner:.1f} m of ring between two arms, not {_LEAST_SECTION} m")
    start = Pose(
        node.x + node.radius * math.cos(angle),
        node.y + node.radius * math.sin(angle),
        angle + math.pi / 2.0,
    )
    # Solid between the lanes: a lane change on so short a piece would end inside the next junction.
    lanes = [LanePlan(-lane - 1, "driving", plan.lane_width, mark="solid") for lane in range(_LANES)]
    piece = Piece(start, 1.0 / node.radius, span * node.radius)
    return plan.add_road(
        node.name, "town", _MPH, [piece], [SectionPlan(0.0, lanes, "solid")], plan.lane_width
    )


def _ring_lane(section: RoadPlan, contact: str, lane: int) -> LaneEnd:
    """Return a lane (0 is the inner one) at the start or end of a section."""
    width = section.sections[0].lanes[lane].width
    if contact == "start":
        return LaneEnd(section, "start", -lane - 1, section.pieces[0].start.beside((0.5 - lane) * width))
    return LaneEnd(section, "end", -lane - 1, section.pieces[-1].end.beside((0.5 - lane) * width))
