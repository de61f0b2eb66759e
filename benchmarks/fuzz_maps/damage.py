"""What is wrong with maps that people have: numbers that are off, links that lead elsewhere, parts gone.

Each function changes a map in place; the result may drive or not.
"""

from __future__ import annotations

from copy import deepcopy
from random import Random
from typing import Any

Element = Any
"""An element of lxml, which has no types."""

_LENGTHS = (1e-6, 1e-3, 0.02, 0.2, 1.0, 20.0)
_NAMES = ("id", "to", "from", "elementId", "junction", "incomingRoad", "connectingRoad", "signalId")
"""Attributes that are numbers and yet names."""
_FACTORS = (-1.0, 0.0, 0.5, 0.9, 0.999, 1.001, 1.1, 2.0, 100.0)


def damage(chance: Random, root: Element) -> None:
    """Apply a few of the damages."""
    for _ in range(chance.choice([1, 1, 1, 2, 3, 6])):
        chance.choice(DAMAGES)(chance, root)


def moved_number(chance: Random, root: Element) -> None:
    """Add a length to some number, or scale it."""
    for element in _some(chance, root, "*"):
        known = sorted(element.attrib.items())
        lengths = [name for name, value in known if _is_number(value) and name not in _NAMES]
        if lengths:
            name = chance.choice(lengths)
            value = float(element.get(name))
            by = chance.choice(_LENGTHS) * chance.choice([-1.0, 1.0])
            element.set(name, repr(value + by if chance.random() < 0.6 else value * chance.choice(_FACTORS)))


def moved_geometry(chance: Random, root: Element) -> None:
    """Move or turn a piece of a reference line, or make it longer or shorter."""
    for geometry in _some(chance, root, "geometry"):
        name = chance.choice(["x", "y", "hdg", "length", "s"])
        by = chance.choice(_LENGTHS) * chance.choice([-1.0, 1.0])
        geometry.set(name, repr(float(geometry.get(name, "0")) + by))


def swapped_elements(chance: Random, root: Element) -> None:
    """Let two links, lane links or connections lead to each other's targets."""
    name = chance.choice(["predecessor", "successor", "laneLink", "connection"])
    found = list(root.iter(name))
    if len(found) > 1:
        one, other = chance.sample(found, 2)
        mine, others = dict(one.attrib), dict(other.attrib)
        one.attrib.clear(), other.attrib.clear()
        one.attrib.update(others), other.attrib.update(mine)


def turned_contact(chance: Random, root: Element) -> None:
    """Name the other end of the road that a link leads to."""
    for link in _some(chance, root, "*[@contactPoint]"):
        link.set("contactPoint", "start" if link.get("contactPoint") == "end" else "end")


def turned_link(chance: Random, root: Element) -> None:
    """Make a successor a predecessor."""
    for link in _some(chance, root, chance.choice(["predecessor", "successor"])):
        link.tag = "predecessor" if link.tag == "successor" else "successor"


def renumbered(chance: Random, root: Element) -> None:
    """Change the number of a lane, or of the one that a link leads to."""
    for element in _some(chance, root, chance.choice(["lane", "laneLink", "successor", "predecessor"])):
        for name in ("id", "to", "from"):
            if _is_number(element.get(name, "")):
                element.set(name, str(int(float(element.get(name))) + chance.choice([-2, -1, 1, 2])))


def another_type(chance: Random, root: Element) -> None:
    """Make lanes drivable that were not, and the other way round."""
    for lane in _some(chance, root, "lane"):
        lane.set("type", "none" if lane.get("type") == "driving" else "driving")


def gone(chance: Random, root: Element) -> None:
    """Leave elements of one kind out."""
    kinds = ["road", "junction", "connection", "laneLink", "lane", "laneSection", "geometry", "width", "link"]
    for element in _some(chance, root, chance.choice([*kinds, "*"])):
        if element.getparent() is not None:
            element.getparent().remove(element)


def twice(chance: Random, root: Element) -> None:
    """Repeat elements."""
    kinds = ["road", "connection", "laneLink", "lane", "laneSection", "geometry", "width", "successor"]
    for element in _some(chance, root, chance.choice(kinds)):
        element.addnext(deepcopy(element))


def cut_out(chance: Random, root: Element) -> None:
    """Leave all roads out but those of a part of the map, as a tool that exports a selection does."""
    roads = root.findall("road")
    share = chance.uniform(0.2, 0.95)
    for road in roads:
        if chance.random() > share:
            root.remove(road)


def another_width(chance: Random, root: Element) -> None:
    """Let lanes have any width: none, some millimetres less than none, or very wide."""
    for width in _some(chance, root, "width"):
        width.set("a", chance.choice(["0", "-0.002", "0.05", "0.8", "6", "25", "-3"]))


def another_curve(chance: Random, root: Element) -> None:
    """Bend a line, or make a curve tighter than its lanes are wide."""
    for name in ("line", "arc"):
        for shape in _some(chance, root, name):
            shape.tag = "arc"
            shape.set("curvature", repr(chance.choice([1e-9, 0.001, -0.05, 0.2, -0.4])))


def step(chance: Random, root: Element) -> None:
    """Lift a piece of road."""
    for elevation in _some(chance, root, "elevation"):
        elevation.set(chance.choice("abcd"), repr(chance.choice([0.1, -0.5, 3.0, 40.0])))


DAMAGES = (
    moved_number,
    moved_number,
    moved_geometry,
    swapped_elements,
    turned_contact,
    turned_link,
    renumbered,
    another_type,
    gone,
    gone,
    twice,
    cut_out,
    another_width,
    another_curve,
    step,
)
"""The kinds; one that is more important comes twice."""


def _some(chance: Random, root: Element, name: str) -> list[Element]:
    """Return one, a few or many of the elements of a name below the root."""
    found = root.findall(f".//{name}")
    return chance.sample(found, min(len(found), chance.choice([1, 1, 1, 2, 5, 20])))


def _is_number(text: str) -> bool:
    try:
        return abs(float(text)) < 1e9
    except ValueError:
        return False
