"""Broken OpenDRIVE files: bytes, numbers, attributes, and elements that are gone, doubled or elsewhere."""

from __future__ import annotations

import copy
import random
from pathlib import Path

from athrl_driving.maps import MapError, load_town
from lxml import etree  # type: ignore[import-untyped]

from benchmarks.fuzz import mutations
from benchmarks.fuzz.frame import Parser, file_parser

TOWN = Path(__file__).parents[2] / "driving" / "athrl_driving" / "maps" / "towns" / "town02.xodr"
_RING = b"""<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="4"/>
<road id="1" length="314.1592653589793" junction="-1" name="ring"><link>
<predecessor elementType="road" elementId="1" contactPoint="end"/>
<successor elementType="road" elementId="1" contactPoint="start"/></link>
<type s="0" type="town"><speed max="40" unit="km/h"/></type>
<planView><geometry s="0" x="0" y="0" hdg="0" length="314.1592653589793"><arc curvature="0.02"/></geometry>
</planView><elevationProfile><elevation s="0" a="1" b="0" c="0" d="0"/></elevationProfile>
<lanes><laneOffset s="0" a="0" b="0" c="0" d="0"/><laneSection s="0"><left>
<lane id="1" type="driving"><link><predecessor id="1"/><successor id="1"/></link>
<width sOffset="0" a="3" b="0" c="0" d="0"/><roadMark sOffset="0" type="broken"/></lane></left>
<center><lane id="0" type="none"/></center><right>
<lane id="-1" type="driving"><link><predecessor id="-1"/><successor id="-1"/></link>
<width sOffset="0" a="3" b="0" c="0" d="0"/><width sOffset="100" a="3" b="0" c="0.00075" d="-0.000025"/>
<width sOffset="120" a="3.1" b="0" c="-0.00075" d="0.000025"/><width sOffset="140" a="3" b="0" c="0" d="0"/>
</lane></right></laneSection></lanes>
<signals><signal s="300" t="-4" id="9" type="1000001" dynamic="yes" orientation="+"/>
<signalReference id="9" s="10" t="4" orientation="-"><validity fromLane="1" toLane="1"/></signalReference>
</signals></road><controller id="c"><control signalId="9"/></controller>
<junction id="5" type="direct"><connection id="0" incomingRoad="1" linkedRoad="1" contactPoint="start">
<laneLink from="-1" to="-1"/></connection><controller id="c"/></junction>
<junction id="6" type="virtual" mainRoad="1" sStart="10" sEnd="20"/></OpenDRIVE>"""

_ODD_VALUES = [
    "", "0", "-1", "1", "1e-9", "1e5", "-1e5", "199999", "1e8", "1e300", "-1e300", "nan", "inf", "1e400",
    "9" * 5_001, "x", "end", "start", "road", "junction", "driving", "none", "&#10;", "LHT", "undefined",
]  # fmt: skip


def opendrive(folder: Path) -> Parser:
    """Return the parser of maps, which also builds the town."""
    seeds = [TOWN.read_bytes(), *[_RING] * 9]  # the town takes a hundred times as long
    breaks = [*mutations.TEXT, *[changed_attributes] * 6, *[changed_elements] * 6]
    return file_parser(seeds, breaks, folder / "some.xodr", load_town, MapError)


def changed_attributes(chance: random.Random, content: bytes) -> bytes:
    """Return the map with attributes that are odd, missing, or one in another's place."""
    root = etree.fromstring(content)
    elements = [element for element in root.iter() if element.attrib]
    for _ in range(chance.choice([1, 1, 1, 2, 5])):
        element = chance.choice(elements)
        if not element.attrib:
            continue
        name = chance.choice(sorted(element.attrib))
        match chance.randrange(5):
            case 0:
                del element.attrib[name]
            case 1:
                other = chance.choice(elements)
                element.attrib[name] = chance.choice(list(other.attrib.values()) or [""])
            case 2:
                element.attrib[name] = _scaled(chance, element.attrib[name])
            case _:
                element.attrib[name] = chance.choice(_ODD_VALUES)
    return bytes(etree.tostring(root))


def changed_elements(chance: random.Random, content: bytes) -> bytes:
    """Return the map with elements that are missing, repeated, or inside another."""
    root = etree.fromstring(content)
    for _ in range(chance.choice([1, 1, 2, 4])):
        inside = list(root.iter())[1:]
        if not inside:
            break
        element, other = chance.choice(inside), chance.choice([root, *inside])
        match chance.randrange(3):
            case 0:
                element.getparent().remove(element)
            case 1:
                parent = element.getparent()
                for _ in range(chance.choice([1, 1, 3, 250])):
                    parent.append(copy.deepcopy(element))
            case _:
                other.append(copy.deepcopy(element))
    return bytes(etree.tostring(root))


def _scaled(chance: random.Random, text: str) -> str:
    """Return a number that is a little, or very, different."""
    try:
        return repr(float(text) * chance.choice([-1.0, 0.5, 0.999, 1.001, 2.0, 10.0, 1e3, 1e6]))
    except (ValueError, OverflowError):
        return text + text
