"""A roundabout with one lane: driven counter-clockwise on the screen, the ring has priority over its entries.

Round the ring, sections and arms alternate. Each arm is a junction of its own with three movements: the
entry from the street, the way past the arm on the ring, and the exit to the street. A section between two
arms is an ordinary lane.
"""

import math

from athrl_driving.maps.curves import Piece, Pose, join, wrap
from athrl_driving.maps.description import TOWN_SPEED, Node
from athrl_driving.maps.lane_graph import TURN_RIGHT, TURN_STRAIGHT
from athrl_driving.maps.sketch import Arm, Sketch

ARM_REACH = 11.0
"""Metres from the ring's centre line to where the streets end."""

MERGE_ANGLE = math.radians(21.0)
"""Angle on the ring between an arm's axis and the points where its exit leaves and its entry joins."""

_LEAST_SECTION = 20.0
"""Metres: a section shorter than two waiting vehicles could fill up and block the ring."""


def lay_roundabout(sketch: Sketch, node: Node, arms: list[Arm]) -> None:
    """Add the ring, entries and exits. Raises `ValueError` where two arms are too close to each other."""
    radius = node.ring_radius

    def ring_pose(angle: float) -> Pose:
        heading = angle - math.pi / 2.0
        return Pose(node.x + radius * math.cos(angle), node.y + radius * math.sin(angle), heading)

    # Driving on the ring is towards smaller angles.
    order = sorted(arms, key=lambda arm: -wrap(arm.direction))
    sections = []
    for index, arm in enumerate(order):
        following = order[(index + 1) % len(order)]
        angle = wrap(arm.direction) - MERGE_ANGLE
        span = (angle - (following.direction + MERGE_ANGLE)) % (2.0 * math.pi)
        if not _LEAST_SECTION <= span * radius < 1.5 * math.pi * radius:
            raise ValueError(
                f"node {node.name}: {span * radius:.1f} m of ring between two arms, not {_LEAST_SECTION}"
            )
        nodes = (f"{node.name}:{index}:joined", f"{node.name}:{(index + 1) % len(order)}:leaves")
        piece = Piece(ring_pose(angle), -1.0 / radius, span * radius)
        sections.append(sketch.add(piece, nodes, 0, TOWN_SPEED))
    for index, arm in enumerate(order):
        junction = sketch.new_junction(node.name, "roundabout")
        before, after = sections[index - 1], sections[index]
        past = Piece(sketch.lanes[before].piece.end, -1.0 / radius, 2.0 * MERGE_ANGLE * radius)
        sketch.add_movement([past], before, after, junction=junction, turn=TURN_STRAIGHT)
        leaving = join(sketch.lanes[before].piece.end, sketch.lanes[arm.outgoing[-1]].piece.start)
        sketch.add_movement(leaving, before, arm.outgoing[-1], junction=junction, turn=TURN_RIGHT)
        entering = join(sketch.lanes[arm.incoming[-1]].piece.end, sketch.lanes[after].piece.start)
        sketch.add_movement(
            entering, arm.incoming[-1], after, junction=junction, turn=TURN_RIGHT, yields=True
        )
