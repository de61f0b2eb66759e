"""Which traffic lights hold for which road, and where: references, and places that cannot be as they are."""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import replace

from athrl_driving.maps.opendrive.model import OpenDrive, Road, Signal

_BEYOND = 0.3
"""Metres by which a light may stand beyond its road's ends without being a fault."""


def place_lights(content: OpenDrive) -> None:
    """Give every road the lights that hold for it, its own and those that it refers to."""
    known = {signal.id for road in content.roads.values() for signal in road.signals}
    for road in content.roads.values():
        lights = [*road.signals, *_referred(content, road, known)]
        road.signals = [_along_lanes(content, road, _on_road(content, road, light)) for light in lights]
        road.references = []
    _check_controllers(content, known)


def _referred(content: OpenDrive, road: Road, known: set[str]) -> Iterator[Signal]:
    for reference in road.references:
        if reference.id in known:
            yield reference
        elif reference.id not in content.other_signals:
            kind = "a reference to a signal that is not there was left out"
            content.findings.add(kind, _place(road, reference))


def _on_road(content: OpenDrive, road: Road, light: Signal) -> Signal:
    """Return the light at the road's end where it stands beyond it."""
    station = min(max(light.s, 0.0), road.length)
    if abs(station - light.s) > _BEYOND:
        kind = "a traffic light beyond its road's end was taken to the end"
        content.findings.add(kind, _place(road, light), abs(station - light.s))
    return replace(light, s=station)


def _along_lanes(content: OpenDrive, road: Road, light: Signal) -> Signal:
    """Return the light without its orientation where all lanes that it names lead the other way.

    CARLA's maps have many of these; who names lanes means them.
    """
    if not light.lanes or light.orientation not in ("+", "-"):
        return light
    section = road.sections[max(bisect_right(road.sections, light.s, key=lambda section: section.s) - 1, 0)]
    lanes = [lane for lane in section.lanes.values() if lane.drives and light.holds_for(lane.id)]
    named = {road.drives_forward(lane) for lane in lanes}
    if not named or (light.orientation == "+") in named:
        return light
    kind = "a traffic light's lanes lie against its orientation: it holds for the lanes"
    content.findings.add(kind, _place(road, light))
    return replace(light, orientation="none")


def _check_controllers(content: OpenDrive, known: set[str]) -> None:
    for name, signals in content.controllers.items():
        for signal in signals:
            if signal not in known and signal not in content.other_signals:
                kind = "a controller's signal that is not there was left out"
                content.findings.add(kind, f"controller {name}, signal {signal}")
    for junction in content.junctions.values():
        for name in junction.controllers:
            if name not in content.controllers:
                kind = "a junction's controller that is not there was left out"
                content.findings.add(kind, f"junction {junction.id}, controller {name}")


def _place(road: Road, light: Signal) -> str:
    return f"road {road.id}, signal {light.id}, line {light.line}"
