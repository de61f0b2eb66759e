"""What a valid map may have besides its network: heights, widths, offsets, lights, limits, kinds of lanes.

Each function changes a map in place, as a tool would write it: the result should drive.
"""

from __future__ import annotations

from copy import deepcopy
from random import Random
from typing import Any

from lxml import etree  # type: ignore[import-untyped]

Element = Any
"""An element of lxml, which has no types."""

_TYPES = ("sidewalk", "shoulder", "parking", "biking", "entry", "exit", "bidirectional", "restricted")
_MARKS = ("none", "solid", "broken", "solid solid", "solid broken", "broken solid", "botts dots")
_TRAFFIC_LIGHT, _STOP, _YIELD = "1000001", "206", "205"
_ORDER = ("link", "type", "planView", "elevationProfile", "lateralProfile", "lanes", "objects", "signals")
"""Of a road's children."""


def decorate(chance: Random, root: Element) -> None:
    """Apply some of the decorations to some of the roads."""
    for road in root.findall("road"):
        if float(road.get("length")) > 5.0:
            for decoration in DECORATIONS:
                if chance.random() < 0.15:
                    decoration(chance, road)
    if chance.random() < 0.1:
        for road in root.findall("road"):
            road.set("rule", "LHT")


def hill(chance: Random, road: Element) -> None:
    """Let the road rise and fall, level at both ends."""
    profile = _child(road, "elevationProfile")
    profile[:] = _bump(road, "elevation", 0.0, chance.uniform(-0.02, 0.02) * float(road.get("length")))


def banked(chance: Random, road: Element) -> None:
    """Bank the road."""
    profile = _child(road, "lateralProfile")
    profile[:] = _bump(road, "superelevation", 0.0, chance.uniform(-0.1, 0.1))


def wider_lanes(chance: Random, road: Element) -> None:
    """Let lanes become wider or narrower and back."""
    if len(road.findall("lanes/laneSection")) > 1:
        return
    for lane in road.iterfind("lanes/laneSection/*/lane[width]"):
        widths = lane.findall("width")
        if len(widths) == 1 and chance.random() < 0.5:
            a = float(widths[0].get("a"))
            index = lane.index(widths[0])
            lane[index : index + 1] = _bump(road, "width", a, chance.uniform(-0.4, 0.5) * a, "sOffset")


def lane_offset(chance: Random, road: Element) -> None:
    """Shift the lanes sideways and back."""
    lanes = road.find("lanes")
    for offset in lanes.findall("laneOffset"):
        lanes.remove(offset)
    lanes[:0] = _bump(road, "laneOffset", 0.0, chance.uniform(-2.0, 2.0))


def two_sections(chance: Random, road: Element) -> None:
    """Divide the only lane section into two that are the same."""
    sections = road.findall("lanes/laneSection")
    if len(sections) != 1 or len(sections[0].findall("*/lane/width")) != len(
        sections[0].findall("*/lane[width]")
    ):
        return
    second = deepcopy(sections[0])
    second.set("s", repr(chance.uniform(0.1, 0.9) * float(road.get("length"))))
    sections[0].addnext(second)
    for section, side in ((sections[0], "successor"), (second, "predecessor")):
        for lane in section.iterfind("*/lane[width]"):
            link = _child(lane, "link")
            for known in link.findall(side):
                link.remove(known)
            etree.SubElement(link, side, id=lane.get("id"))


def lights(chance: Random, road: Element) -> None:
    """Add a light, a stop sign or a yield sign, with or without a controller."""
    signals = _child(road, "signals")
    kind = chance.choice([_TRAFFIC_LIGHT, _TRAFFIC_LIGHT, _STOP, _YIELD])
    number = f"{road.get('id')}-{len(signals)}"
    etree.SubElement(
        signals,
        "signal",
        id=number,
        type=kind,
        s=repr(chance.uniform(0.0, 1.0) * float(road.get("length"))),
        t=repr(chance.uniform(-6.0, 6.0)),
        dynamic="yes" if kind == _TRAFFIC_LIGHT else "no",
        orientation=chance.choice(["+", "-", "none"]),
    )
    if kind == _TRAFFIC_LIGHT and chance.random() < 0.5:
        controller = etree.SubElement(road.getparent(), "controller", id=f"c{chance.randrange(3)}")
        etree.SubElement(controller, "control", signalId=number)


def speed_limit(chance: Random, road: Element) -> None:
    """Set a speed limit."""
    for known in road.findall("type"):
        road.remove(known)
    unit, most = chance.choice([("km/h", 130.0), ("mph", 75.0), ("m/s", 40.0)])
    kind = etree.Element("type", s="0", type=chance.choice(["town", "rural", "motorway"]))
    etree.SubElement(kind, "speed", max=f"{chance.uniform(5.0, most):.1f}", unit=unit)
    road.find("planView").addprevious(kind)


def other_kind_of_lane(chance: Random, road: Element) -> None:
    """Make the outermost lane of a side a sidewalk or another lane."""
    side, order = chance.choice([("left", max), ("right", min)])
    for section in road.iterfind("lanes/laneSection"):
        lanes = section.findall(f"{side}/lane")
        if len(lanes) > 1:
            order(lanes, key=lambda lane: int(lane.get("id"))).set("type", chance.choice(_TYPES))


def marks(chance: Random, road: Element) -> None:
    """Change marks between lanes, which say where lanes may be changed."""
    for mark in road.iterfind("lanes/laneSection/*/lane/roadMark"):
        mark.set("type", chance.choice(_MARKS))


DECORATIONS = (
    hill,
    banked,
    wider_lanes,
    lane_offset,
    two_sections,
    lights,
    speed_limit,
    other_kind_of_lane,
    marks,
)
"""All that are applied to a road."""


def _bump(road: Element, name: str, base: float, height: float, along: str = "s") -> list[Element]:
    """Return a profile that goes smoothly from `base` to `base + height` at the road's middle and back."""
    half = 0.5 * float(road.get("length"))
    c, d = 3.0 * height / half**2, -2.0 * height / half**3
    up = {along: "0", "a": repr(base), "b": "0", "c": repr(c), "d": repr(d)}
    down = {along: repr(half), "a": repr(base + height), "b": "0", "c": repr(-c), "d": repr(-d)}
    return [etree.Element(name, up), etree.Element(name, down)]


def _child(element: Element, name: str) -> Element:
    """Return an element's child of that name, made at its place if there is none."""
    child = element.find(name)
    if child is None:
        child = etree.Element(name)
        before = _ORDER[: _ORDER.index(name)]
        element.insert(sum(each.tag in before for each in element), child)
    return child
