"""How far an accelerated road is from highway-env's own: the same scene twice, frame by frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.road.road import Road

NUMBERS = ("heading", "speed", "target_speed", "timer", "lateral_speed", "yaw_rate", "yield_timer")
EXACT = ("lane_index", "target_lane_index", "crashed", "hit", "route", "is_yielding")
_ABSENT = {"is_yielding": False, "yield_timer": 0}


def difference(plain: Road, accelerated: Road) -> float:
    """Return the greatest difference between positions (m), headings (rad), speeds (m/s) and the like.

    Actions are not compared, only their effects: at a standstill highway-env's steering magnifies the
    last bit of a position a hundred thousand times, without effect. Infinite if lanes, target
    lanes, routes, crashes or yielding vehicles differ, or the numbers of vehicles.
    """
    return max((value for _, value in differences(plain, accelerated)), default=0.0)


def differences(plain: Road, accelerated: Road) -> list[tuple[str, float]]:
    """Return the differences, each as a description and a size; see `difference`."""
    ones, others = plain.vehicles + plain.objects, accelerated.vehicles + accelerated.objects
    if len(ones) != len(others):
        return [(f"{len(ones)} vehicles and objects, not {len(others)}", np.inf)]
    found = []
    for number, (one, other) in enumerate(zip(ones, others, strict=True)):
        for name, size in _differences(one, other):
            if size > 0.0 or np.isnan(size):
                shown = getattr(one, name, None), getattr(other, name, None)
                found.append(
                    (f"{name} of {number}: {shown[0]}, not {shown[1]}", np.inf if np.isnan(size) else size)
                )
    return found


def _differences(one: Any, other: Any) -> list[tuple[str, float]]:
    found = [("position", float(np.abs(np.subtract(one.position, other.position)).max()))]
    impacts = one.impact, other.impact
    if hasattr(one, "action") and any(impact is not None for impact in impacts):
        lost = any(impact is None for impact in impacts)
        found.append(("impact", np.inf if lost else float(np.abs(np.subtract(*impacts)).max())))
    for name in NUMBERS:
        if hasattr(one, name):
            found.append((name, abs(float(getattr(one, name)) - float(getattr(other, name)))))
    for name in EXACT:
        if getattr(one, name, _ABSENT.get(name)) != getattr(other, name, _ABSENT.get(name)):
            found.append((name, np.inf))
    return found


def copy_state(plain: Road, accelerated: Road) -> None:
    """Give an accelerated road's vehicles and objects the state of the plain road's."""
    ones, others = plain.vehicles + plain.objects, accelerated.vehicles + accelerated.objects
    for one, other in zip(ones, others, strict=True):
        other.position = np.array(one.position)
        other.lane_index = one.lane_index
        for name in (*NUMBERS, "crashed", "hit", "target_lane_index", "is_yielding"):
            if hasattr(one, name):
                setattr(other, name, getattr(one, name))
        if hasattr(one, "action"):
            other.action = dict(one.action)
            other.impact = None if one.impact is None else np.array(one.impact)
        if hasattr(one, "route"):
            other.route = None if one.route is None else list(one.route)
    if hasattr(plain, "steps"):
        accelerated.steps = plain.steps
