"""Connect the arms of a junction: every arm with every other one, turns keep to their side."""

import math

from athrl_driving.maps.making.curves import join, wrap
from athrl_driving.maps.making.description import Node
from athrl_driving.maps.making.plan import Arm, ControllerPlan, JunctionPlan, RoadPlan, TownPlan

TOLERANCE = 0.2
"""Metres by which a lane through a junction may be tighter than the junction's right turns."""

_STRAIGHT_WITHIN = math.radians(35.0)
_OPPOSITE_WITHIN = math.radians(45.0)


def lay_junction(plan: TownPlan, node: Node, arms: list[Arm]) -> None:
    """Add a junction with all its connecting roads, priorities and signals.

    Raises `ValueError` where a connection would be too tight, or an incoming lane leads nowhere.
    """
    junction = plan.add_junction(node.name)
    laid: list[tuple[bool, RoadPlan]] = []
    for arm in arms:
        used = set()
        for target in arms:
            if target is arm:
                continue
            for entering, leaving in _lane_pairs(arm, target):
                start, end = arm.incoming[entering], target.outgoing[leaving]
                try:
                    pieces = join(start.pose, end.pose, node.turn_radius - TOLERANCE)
                except ValueError as error:
                    raise ValueError(f"node {node.name}: {error}") from None
                laid.append((arm.major, plan.connect(junction, start, end, pieces)))
                used.add(entering)
        if len(used) < len(arm.incoming):
            raise ValueError(f"node {node.name}: a lane of {arm.incoming[0].road.name} leads nowhere")
    junction.priorities = [
        (high.number, low.number) for major, high in laid if major for minor, low in laid if not minor
    ]
    if node.signals:
        _add_signals(plan, junction, arms)


def _lane_pairs(arm: Arm, target: Arm) -> list[tuple[int, int]]:
    """Return which incoming lane (from the left) leads to which outgoing lane."""
    entering, leaving = len(arm.incoming), len(target.outgoing)
    if not entering or not leaving:
        return []
    change = wrap(target.direction - (arm.direction + math.pi))
    if change > _STRAIGHT_WITHIN:
        return [(0, 0)]
    if change < -_STRAIGHT_WITHIN:
        return [(entering - 1, leaving - 1)]
    # Where fewer lanes leave, the others only turn: no two lanes merge within a junction.
    return [(min(lane, entering - 1), lane) for lane in range(leaving)]


def _add_signals(plan: TownPlan, junction: JunctionPlan, arms: list[Arm]) -> None:
    """Give arms that lie opposite each other one controller, and every other arm one of its own."""
    groups: list[list[Arm]] = []
    for arm in arms:
        if not arm.incoming:
            continue
        for group in groups:
            if abs(wrap(group[0].direction - arm.direction + math.pi)) < _OPPOSITE_WITHIN:
                group.append(arm)
                break
        else:
            groups.append([arm])
    for group in groups:
        signals = [plan.add_signal(f"{junction.name}, {arm.incoming[0].road.name}", arm) for arm in group]
        number = len(plan.controllers) + 1
        plan.controllers.append(ControllerPlan(number, f"{junction.name} {number}", signals))
        junction.controllers.append(number)
