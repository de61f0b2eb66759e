"""Reads an OpenDRIVE file: every element that driving lanes need, checked as it is read."""

import io
import re
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE, BOM_UTF32_BE, BOM_UTF32_LE
from collections.abc import Iterator
from pathlib import Path

from athrl_spaces.untrusted import one_line, parser_errors, read_untrusted
from lxml import etree  # type: ignore[import-untyped]

from athrl_driving.maps.findings import Findings
from athrl_driving.maps.opendrive.bounds import (
    GAP,
    LARGEST_FILE,
    LONGEST_TEXT,
    MOST_ATTRIBUTES,
    MOST_ELEMENTS,
)
from athrl_driving.maps.opendrive.element_reader import ElementReader
from athrl_driving.maps.opendrive.lights import place_lights
from athrl_driving.maps.opendrive.model import (
    Cubic,
    JunctionRecord,
    MapError,
    OpenDrive,
    Road,
    RoadLink,
    SpeedLimit,
)
from athrl_driving.maps.opendrive.reading_geometry import read_reference_line
from athrl_driving.maps.opendrive.reading_junctions import read_contact, read_junction
from athrl_driving.maps.opendrive.reading_lanes import read_sections
from athrl_driving.maps.opendrive.reading_signals import read_controller, read_signals
from athrl_driving.maps.opendrive.virtual_junctions import leave_out_virtual_junctions

_NO_LINE = "a road without a reference line was left out"

_ENCODING = re.compile(rb"<\?xml[^>]*encoding=[\"']([^\"']+)")

_ENTITY = re.compile(rb"&(?!(?:amp|lt|gt|quot|apos);)[A-Za-z_][\w.-]{0,60};")
"""A reference to an entity that XML itself does not define."""


def read_opendrive(path: Path, strict: bool = False) -> OpenDrive:
    """Return a file's content; small faults are among its `findings`, and errors where it is read strictly.

    Raises `MapError` (a `ValueError`) with one line that names the file, and the road, lane and line where
    something is wrong: no XML, not OpenDRIVE, an attribute that is missing or not a number, a reference line
    that does not cover its road.
    """
    with parser_errors(lambda reason: MapError(f"{one_line(str(path))}: {reason}")):
        text = read_untrusted(path, LARGEST_FILE)
    return parse_opendrive(one_line(path.name), text, strict)


def parse_opendrive(name: str, text: bytes, strict: bool = False) -> OpenDrive:
    """`read_opendrive` of a file's text; errors call it `name`."""
    _check_size(name, text)
    findings = Findings(name, strict)
    reader, content = ElementReader(name, findings), OpenDrive(name, {}, {}, findings)
    try:
        for element in _parts(name, _as_utf8(findings, text)):
            _read_part(reader, content, element)
    except etree.XMLSyntaxError as error:
        raise MapError(f"{name}: {_why_not_xml(text, error)}") from None
    if not content.roads:
        raise MapError(f"{name}: {_why_no_roads(findings)}")
    _check_junctions(content)
    place_lights(content)
    leave_out_virtual_junctions(content)
    return content


def _check_size(name: str, text: bytes) -> None:
    """Refuse a file that needs too much memory as a tree: every element has a `<`, every attribute a `=`."""
    if text[:4] in (BOM_UTF32_BE, BOM_UTF32_LE):
        raise MapError(f"{name}: line 1: it is encoded in UTF-32, it must be in UTF-8 or UTF-16")
    begins = text.lstrip()[:3]
    if begins[:1] != b"<" and begins != BOM_UTF8 and begins[:2] not in (BOM_UTF16_LE, BOM_UTF16_BE):
        raise MapError(f"{name}: line 1: this is not well-formed XML: it does not begin with '<'")
    for what, sign, most in (("elements", b"<", 2 * MOST_ELEMENTS), ("attributes", b"=", MOST_ATTRIBUTES)):
        if text.count(sign) > most:
            raise MapError(f"{name}: it has too many XML {what}: more than {most:,} {sign.decode()!r}")


def _as_utf8(findings: Findings, text: bytes) -> bytes:
    """Return a text that says it is UTF-8 but is not as UTF-8: names with umlauts in Latin-1, for the most.

    A file that begins with a mark of its encoding, or names another one, is left to the parser.
    """
    declared = _ENCODING.match(text[:200])
    if text[:2] in (BOM_UTF16_LE, BOM_UTF16_BE) or (
        declared and declared[1].lower() not in (b"utf-8", b"utf8")
    ):
        return text
    try:
        text.decode()
    except UnicodeDecodeError as error:
        line = text.count(b"\n", 0, error.start) + 1
        findings.add("text that is not UTF-8 was read as Latin-1", f"line {line}")
        return text.removeprefix(BOM_UTF8).decode("latin-1").encode()
    return text


def _why_not_xml(text: bytes, error: etree.XMLSyntaxError) -> str:
    """Return line and reason of a parser's error; it has no line for an entity that is not defined."""
    entity = None if error.lineno else _ENTITY.search(text)
    if entity is not None:
        line, called = text.count(b"\n", 0, entity.start()) + 1, one_line(entity[0].decode("latin-1"))
        return f"line {line}: this is not well-formed XML: the entity {called} is not defined"
    where = f"line {error.lineno}: " if error.lineno else ""
    return f"{where}this is not well-formed XML: {one_line(error.msg or '')}"


def _parts(name: str, text: bytes) -> Iterator[etree._Element]:
    """Yield the header, roads, junctions and controllers; the memory of each is freed when the next is read.

    The parser's own limits stay on: depth, length of texts, growth by entities.
    """
    events = etree.iterparse(
        io.BytesIO(text), tag=["{*}header", "{*}road", "{*}junction", "{*}controller"],
        resolve_entities=False, remove_comments=True, remove_pis=True,
    )  # fmt: skip
    for _, element in events:
        root = element.getparent()
        if root is None or root.getparent() is not None:
            continue  # deeper in the tree the names mean something else
        _check_root(name, root)
        own = etree.QName(root).namespace
        if etree.QName(element).namespace in (own, None):
            _strip_namespaces(element, own)
            yield element
        element.clear()
        while element.getprevious() is not None:
            del root[0]
    _check_root(name, events.root)


def _strip_namespaces(element: etree._Element, own: str | None) -> None:
    """Give elements of the root's namespace plain names, and remove others: they are no OpenDRIVE."""
    for inner in list(element.iter("{*}*")):
        called = etree.QName(inner)
        if called.namespace in (own, None):
            inner.tag = called.localname
        else:
            inner.getparent().remove(inner)


def _check_root(name: str, root: etree._Element) -> None:
    tag = etree.QName(root).localname
    if tag != "OpenDRIVE":
        raise MapError(f"{name}: line {root.sourceline}: the root is <{tag}>, it must be <OpenDRIVE>")
    types = root.getroottree().docinfo.internalDTD
    if types is not None and next(types.iterentities(), None) is not None:
        raise MapError(f"{name}: it has a document type with entities, which OpenDRIVE does not need")


def _revision(element: etree._Element) -> str:
    """Return the revision that a file names; nothing that is read depends on it."""
    parts = (element.get("revMajor", ""), element.get("revMinor", ""))
    return one_line(".".join(part.strip() for part in parts if part.strip()))[:LONGEST_TEXT]


def _read_part(reader: ElementReader, content: OpenDrive, element: etree._Element) -> None:
    if element.tag == "header":
        content.revision = _revision(element)
        return
    reader.road, reader.lane = "", None
    if element.tag == "road":
        road = _read_road(reader, content, element)
        if road.id in content.roads:
            raise reader.error(element, "there is already a road with this id")
        if road.geometries:
            content.roads[road.id] = road
        else:
            reader.note(element, _NO_LINE)
    elif element.tag == "junction":
        _add_junction(content, read_junction(reader, content, element))
    else:
        read_controller(reader, content, element)


def _why_no_roads(findings: Findings) -> str:
    if any(finding.kind == _NO_LINE for finding in findings):
        return "no <road> in the file has a reference line (<planView> with <geometry>)"
    return "there is no <road> in the file"


def _check_junctions(content: OpenDrive) -> None:
    """Read roads as ordinary ones that claim to be in a junction of which the file knows nothing else.

    If other roads lead to the junction, its own element was lost, for example where a map was cut out of a
    larger one, and the roads are still those through it.
    """
    links = [link for road in content.roads.values() for link in (road.predecessor, road.successor)]
    known = content.junctions.keys() | {link.id for link in links if link is not None and link.is_junction}
    for road in content.roads.values():
        if road.in_junction and road.junction not in known:
            kind = "a road of a junction that is not in the file was read as an ordinary road"
            content.note(kind, road.id, None, road.line)
            road.junction = "-1"


def _add_junction(content: OpenDrive, junction: JunctionRecord) -> None:
    """Add a junction; what a second one with the same id says is added to the first."""
    known = content.junctions.setdefault(junction.id, junction)
    if known is not junction:
        place = f"junction {junction.id}, line {junction.line}"
        content.findings.add("two junctions with the same id were read as one", place)
        known.connections += junction.connections
        known.priorities += junction.priorities
        known.controllers += junction.controllers


def _read_road(reader: ElementReader, content: OpenDrive, element: etree._Element) -> Road:
    reader.road, reader.lane = reader.text(element, "id"), None
    geometries, length = read_reference_line(reader, element, reader.length(element))
    signals, references = read_signals(reader, content, element)
    return Road(
        id=reader.road,
        name=_name(element) or f"road {reader.road}",
        length=length,
        junction=(element.get("junction") or "").strip() or "-1",
        left_hand_traffic=_rule(reader, element) == "LHT",
        predecessor=_read_link(reader, element.find("link/predecessor")),
        successor=_read_link(reader, element.find("link/successor")),
        speeds=_read_speeds(reader, element),
        geometries=geometries,
        elevations=_read_heights(reader, element, length),
        offsets=reader.cubics(element.iterfind("lanes/laneOffset"), "s", 0.0),
        sections=read_sections(reader, element, length),
        signals=signals,
        references=references,
        line=element.sourceline or 0,
    )


def _read_heights(reader: ElementReader, road: etree._Element, length: float) -> list[Cubic]:
    """Return the records of a road's height in order, without those that begin at its end or behind it."""
    heights = reader.cubics(road.iterfind("elevationProfile/elevation"), "s", 0.0)
    kept = [record for record in heights if record.s < length]
    if len(kept) < len(heights) and heights[-1].s > length + GAP:
        reader.note(road, "a height behind the end of its road was passed over", heights[-1].s - length)
    return kept or heights[:1]


def _read_speeds(reader: ElementReader, road: etree._Element) -> list[SpeedLimit]:
    """Return the speed limits of a road's types in order; one ends where a type without one begins."""
    limits: list[SpeedLimit] = []
    for kind in road.iterchildren("type"):
        speeds = list(kind.iterchildren("speed"))
        limits += [reader.speed(speed, reader.offset(kind, "s")) for speed in speeds]
        if limits and not speeds:
            limits.append(SpeedLimit(reader.offset(kind, "s"), None))
    return sorted(limits, key=lambda limit: limit.s)


def _rule(reader: ElementReader, element: etree._Element) -> str:
    rule = element.get("rule", "RHT")
    if rule.upper() not in ("RHT", "LHT"):
        raise reader.error(element, f"its rule is {rule!r}, it must be RHT or LHT")
    if rule != rule.upper():
        reader.note(element, "a rule of the road in small letters was read as in capitals")
    return str(rule.upper())


def _name(element: etree._Element) -> str:
    return one_line(element.get("name") or "")[:LONGEST_TEXT]


def _read_link(reader: ElementReader, element: etree._Element | None) -> RoadLink | None:
    if element is None:
        return None
    kind, target = element.get("elementType"), element.get("elementId")
    if kind == "road" and element.get("elementS") is not None:
        return None  # to the middle of a road, as in virtual junctions
    if not (kind and target) or (kind == "road" and not element.get("contactPoint")):
        reader.note(element, "a link that does not say where it leads was passed over")
        return None
    if kind not in ("road", "junction"):
        raise reader.error(element, f"elementType is {kind!r}, it must be road or junction")
    contact = read_contact(reader, element) if kind == "road" else ""
    return RoadLink(kind == "junction", reader.text(element, "elementId"), contact, element.sourceline or 0)
