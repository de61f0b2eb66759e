"""Which traffic light governs which movement: it stands at its stop line or along it."""

from collections import defaultdict
from collections.abc import Iterator

from athrl_driving.maps.opendrive.bounds import MOST_LIGHT_STEPS
from athrl_driving.maps.opendrive.carriageways import Carriageway, LaneSegment
from athrl_driving.maps.opendrive.model import MapError, OpenDrive, Road, Signal
from athrl_driving.maps.standing_segments import Movement

STOP_LINE_WITHIN = 50.0
"""Metres before a junction within which a light belongs to it; others are for pedestrians on the way."""

_BESIDE = 1.0
"""Metres by which a light may stand beyond a part of a road and still belong to it."""

_Direction = tuple[str, bool]
"""A road's id, and whether vehicles drive along growing stations."""


def governing_lights(content: OpenDrive, movements: list[Movement]) -> list[Signal | None]:
    """Return for every movement [M] the light that governs it. Raises `MapError` for too many lights.

    The first of several is taken, in the order of the movement. Lights that govern nothing are findings.
    """
    _refuse_many(content, movements)
    stops: dict[_Direction, set[float]] = defaultdict(set)
    for movement in movements:
        stops[_direction(movement.origin.carriageway)].add(_stop_line(movement.origin.carriageway))
    found = [list(_lights_of(movement, stops)) for movement in movements]
    _note_idle_lights(content, {light.id for own in found for light in own})
    return [own[0] if own else None for own in found]


def _refuse_many(content: OpenDrive, movements: list[Movement]) -> None:
    """Raise `MapError` where it would take too long to look at the lights of all movements."""
    count = {road.id: sum(1 + len(light.lanes) for light in road.signals) for road in content.roads.values()}
    steps = sum(
        count[segment.carriageway.road.id]
        for movement in movements
        for segment in (movement.origin, *movement.segments)
    )
    if steps > MOST_LIGHT_STEPS:
        lights = sum(len(road.signals) for road in content.roads.values())
        raise MapError(f"{content.name}: it has too many traffic lights: {lights:,}")


def _lights_of(movement: Movement, stops: dict[_Direction, set[float]]) -> Iterator[Signal]:
    origin = movement.origin.carriageway
    for light in origin.road.signals:
        if _holds_for(light, movement.origin) and _at_stop_line(light, origin, stops[_direction(origin)]):
            yield light
    for segment in movement.segments:
        for light in segment.carriageway.road.signals:
            if _holds_for(light, segment) and _stands_beside(light, segment.carriageway):
                yield light


def _holds_for(light: Signal, segment: LaneSegment) -> bool:
    forward = segment.carriageway.forward
    if (light.orientation == "+" and not forward) or (light.orientation == "-" and forward):
        return False
    return light.holds_for(segment.keys[-1][1])


def _at_stop_line(light: Signal, origin: Carriageway, stops: set[float]) -> bool:
    """Tell whether a light stands at the end of the road where the vehicles of `origin` wait."""
    stop = _stop_line(origin)
    nearest = min(stops, key=lambda other: abs(other - light.s))
    in_its_half = (light.s >= 0.5 * origin.road.length) == origin.forward
    return stop == nearest and in_its_half and abs(stop - light.s) <= STOP_LINE_WITHIN


def _stands_beside(light: Signal, carriageway: Carriageway) -> bool:
    """Tell whether a light stands on a part of a movement; that of a connecting road holds all along it."""
    if carriageway.road.in_junction:
        return True
    return carriageway.start - _BESIDE <= light.s <= carriageway.end + _BESIDE


def _direction(carriageway: Carriageway) -> _Direction:
    return carriageway.road.id, carriageway.forward


def _stop_line(carriageway: Carriageway) -> float:
    """Return the station (m) where vehicles leave a carriageway."""
    return carriageway.end if carriageway.forward else carriageway.start


def _note_idle_lights(content: OpenDrive, used: set[str]) -> None:
    """Note each light that governs nothing, wherever it is referred to."""
    idle: dict[str, tuple[Road, Signal]] = {}
    for road in content.roads.values():
        for light in road.signals:
            if light.id not in used:
                idle.setdefault(light.id, (road, light))
    for road, light in idle.values():
        kind = "a traffic light that no way through a junction passes was left out"
        place = f"road {road.id}, signal {light.id}, line {light.line}"
        content.findings.add(kind, place, allowed=True)
