"""Reads a road's traffic lights, its references to signals of other roads, and controllers.

A reference is how most lights of CARLA's and RoadRunner's maps are written: the signal stands where its mast
is and names no lane, and each road that it holds for refers to it.
"""

from __future__ import annotations

from lxml import etree  # type: ignore[import-untyped]

from athrl_driving.maps.opendrive.element_reader import ElementReader
from athrl_driving.maps.opendrive.model import MapError, OpenDrive, Signal

VEHICLE_LIGHTS = frozenset({"1000001", "1000009", "1000010", "1000011", "1000012"})
"""OpenDRIVE's signal types of traffic lights for vehicles: with three colours or two, and with arrows.

Which way an arrow points (the subtype) is passed over: exporters write it for full lights too.
"""

OTHER_LIGHTS = frozenset({"1000002", "1000007", "1000013", "1000014"})
"""Types of lights for pedestrians, bicycles and trams, which no vehicle here is."""

_LIGHTS_BEGIN_WITH = "10000"

UNREADABLE = "a traffic light, or a reference to one, that cannot be read was left out"


def read_signals(
    reader: ElementReader, content: OpenDrive, road: etree._Element
) -> tuple[list[Signal], list[Signal]]:
    """Return a road's own traffic lights, and its references, whose signals may not have been read yet."""
    lights, references = [], []
    for element in road.iterfind("signals/signal"):
        light = _readable(reader, element) if _is_light(reader, content, element) else None
        if light is None:
            content.other_signals.add(element.get("id") or "")
        else:
            content.count_light(light)
            lights.append(light)
    for element in road.iterfind("signals/signalReference"):
        reference = _readable(reader, element)
        if reference is not None:
            content.count_light(reference)
            references.append(reference)
    return lights, references


def _is_light(reader: ElementReader, content: OpenDrive, element: etree._Element) -> bool:
    """Tell whether a signal is a traffic light for vehicles, and note the lights that are passed over."""
    kind, changes = element.get("type") or "", element.get("dynamic") != "no"
    if kind in VEHICLE_LIGHTS and changes:
        return True
    if kind in VEHICLE_LIGHTS:
        passed_over = "a traffic light that never changes (dynamic is no) was left out"
    elif changes and kind.startswith(_LIGHTS_BEGIN_WITH) and kind not in OTHER_LIGHTS:
        passed_over = "a light of a type that is not known was left out"
    else:
        return False
    content.findings.add(passed_over, reader.place(element), allowed=True)
    return False


def _readable(reader: ElementReader, element: etree._Element) -> Signal | None:
    """Return a light or a reference; None, and a note, where it is damaged: roads are driven without it."""
    try:
        return _read_signal(reader, element)
    except MapError as error:
        reader.findings.add(UNREADABLE, str(error).removeprefix(f"{reader.name}: "))
        return None


def _read_signal(reader: ElementReader, element: etree._Element) -> Signal:
    lanes = (
        (reader.whole(valid, "fromLane"), reader.whole(valid, "toLane"))
        for valid in element.iterchildren("validity")
    )
    return Signal(
        id=reader.text(element, "id"),
        s=reader.station(element, "s"),
        orientation=element.get("orientation", "none"),
        lanes=tuple((min(pair), max(pair)) for pair in lanes),
        line=element.sourceline or 0,
    )


def read_controller(reader: ElementReader, content: OpenDrive, element: etree._Element) -> None:
    """Note the signals that a controller switches together."""
    signals = content.controllers.setdefault(reader.text(element, "id"), [])
    signals += [reader.text(control, "signalId") for control in element.iterchildren("control")]
