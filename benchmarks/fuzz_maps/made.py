"""The maps of the fuzz by their number: generated, decorated, and for the most part damaged."""

from __future__ import annotations

from random import Random
from typing import Any
from xml.etree import ElementTree

from athrl_driving.maps import TOWNS
from lxml import etree  # type: ignore[import-untyped]

from benchmarks.fuzz.maps import TOWN, changed_attributes, changed_elements
from benchmarks.fuzz_maps.damage import damage
from benchmarks.fuzz_maps.decorations import decorate
from benchmarks.fuzz_maps.networks import NETWORKS

_SHARE_OF_TOWNS = 0.02
"""Of the damaged maps; a town takes as long as fifty generated ones."""

_LONGEST_ROAD = 1500.0
"""Metres; the curve that ties two ends may go far around."""


def made_map(seed: int, number: int) -> bytes:
    """Return the content of a map; seed and number make the same one again."""
    chance = Random(f"{seed} {number}")
    if chance.random() < 0.25:
        return bytes(etree.tostring(_generated(chance)))
    root = _base(chance)
    if chance.random() < 0.15:
        change = chance.choice([changed_attributes, changed_elements])
        return change(chance, bytes(etree.tostring(root)))
    damage(chance, root)
    return bytes(etree.tostring(root))


def _base(chance: Random) -> Any:
    """Return a map to damage."""
    if chance.random() < _SHARE_OF_TOWNS:
        return etree.parse(str(TOWN.with_stem(chance.choice(TOWNS)))).getroot()
    return _generated(chance)


def _generated(chance: Random) -> Any:
    """Return a generated map, decorated or not."""
    root = _network(chance)
    while max(float(road.get("length")) for road in root.findall("road")) > _LONGEST_ROAD:
        root = _network(chance)
    if chance.random() < 0.7:
        decorate(chance, root)
    return root


def _network(chance: Random) -> Any:
    network = chance.choice(NETWORKS)(chance)
    return etree.fromstring(ElementTree.tostring(network.get_element()))
