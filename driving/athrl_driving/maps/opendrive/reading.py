"""Reading an OpenDRIVE file: every element that driving lanes need, checked as it is read."""

import math
from collections.abc import Iterator
from pathlib import Path

from lxml import etree  # type: ignore[import-untyped]

from athrl_driving.maps.opendrive.model import (
    Connection,
    Cubic,
    Geometry,
    JunctionRecord,
    MapError,
    OpenDrive,
    Road,
    RoadLink,
    Signal,
    SpeedLimit,
)
from athrl_driving.maps.opendrive.reading_lanes import read_sections

TRAFFIC_LIGHT = "1000001"
"""OpenDRIVE's signal type of a traffic light with three colours."""

_SPEED_UNITS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}

_GEOMETRIES = {
    "line": (),
    "arc": ("curvature",),
    "spiral": ("curvStart", "curvEnd"),
    "poly3": ("a", "b", "c", "d"),
    "paramPoly3": ("aU", "bU", "cU", "dU", "aV", "bV", "cV", "dV"),
}


class Reader:
    """Attributes of elements as numbers; errors name the file, the road, the lane and the line."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.road = ""
        self.lane: int | None = None

    def error(self, element: etree._Element, message: str) -> MapError:
        """Return the error for an element's place."""
        places = [f"road {self.road}"] if self.road else []
        if self.lane is not None:
            places.append(f"lane {self.lane}")
        places.append(f"line {element.sourceline}")
        return MapError(f"{self.name}: {', '.join(places)}: {message}")

    def text(self, element: etree._Element, attribute: str) -> str:
        """Return a required attribute."""
        value = element.get(attribute)
        if value is None:
            raise self.error(element, f"<{element.tag}> has no attribute {attribute!r}")
        return value

    def number(self, element: etree._Element, attribute: str, default: float | None = None) -> float:
        """Return an attribute as a finite number."""
        text = element.get(attribute)
        if text is None and default is not None:
            return default
        text = self.text(element, attribute)
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.error(element, f"{attribute} of <{element.tag}> is {text!r}, it must be a number")
        return value

    def whole(self, element: etree._Element, attribute: str) -> int:
        """Return an attribute as a whole number."""
        text = self.text(element, attribute)
        try:
            return int(text)
        except ValueError:
            raise self.error(
                element, f"{attribute} of <{element.tag}> is {text!r}, it must be a whole number"
            ) from None

    def cubics(self, elements: Iterator[etree._Element], station: str, begin: float) -> list[Cubic]:
        """Return polynomials in order; `station` is the attribute with their start, from `begin` on."""
        records = [
            Cubic(
                s=begin + self.number(element, station),
                a=self.number(element, "a"),
                b=self.number(element, "b"),
                c=self.number(element, "c"),
                d=self.number(element, "d"),
                line=element.sourceline or 0,
            )
            for element in elements
        ]
        return sorted(records, key=lambda record: record.s)

    def speed(self, element: etree._Element, start: float) -> SpeedLimit:
        """Return the speed limit that holds from station `start` on."""
        text = self.text(element, "max")
        if text in ("no limit", "undefined"):
            return SpeedLimit(start, None)
        unit = element.get("unit", "m/s")
        if unit not in _SPEED_UNITS:
            raise self.error(element, f"the speed's unit is {unit!r}, it must be one of m/s, km/h, mph")
        limit = self.number(element, "max") * _SPEED_UNITS[unit]
        if limit <= 0.0:
            raise self.error(element, f"the speed limit is {text!r}, it must be above 0")
        return SpeedLimit(start, limit)


def read_opendrive(path: Path) -> OpenDrive:
    """Return a file's content.

    Raises `MapError` (a `ValueError`) with one line that names the file, and the road, lane and line where
    something is wrong: no XML, not OpenDRIVE, an attribute missing or no number, a road without a reference
    line or with a gap in it, links to roads that are not there.
    """
    try:
        root = etree.parse(str(path), etree.XMLParser(resolve_entities=False, huge_tree=True)).getroot()
    except OSError:
        raise MapError(f"{path}: there is no such file, or it cannot be read") from None
    except etree.XMLSyntaxError as error:
        raise MapError(
            f"{path.name}: line {error.lineno}: this is not well-formed XML: {error.msg}"
        ) from None
    for element in root.iter("{*}*"):
        element.tag = etree.QName(element).localname
    if root.tag != "OpenDRIVE":
        raise MapError(
            f"{path.name}: line {root.sourceline}: the root is <{root.tag}>, it must be <OpenDRIVE>"
        )
    reader = Reader(path.name)
    content = OpenDrive(path.name, {}, {})
    for element in root.iterchildren("road"):
        road = _read_road(reader, element)
        if road.id in content.roads:
            raise reader.error(element, "there is already a road with this id")
        content.roads[road.id] = road
    reader.road = ""
    for element in root.iterchildren("junction"):
        junction = _read_junction(reader, element)
        content.junctions[junction.id] = junction
    for element in root.iterchildren("controller"):
        signals = [reader.text(control, "signalId") for control in element.iterchildren("control")]
        content.controllers[reader.text(element, "id")] = signals
    if not content.roads:
        raise MapError(f"{path.name}: line {root.sourceline}: there is no <road> in the file")
    return content


def _read_road(reader: Reader, element: etree._Element) -> Road:
    reader.road, reader.lane = reader.text(element, "id"), None
    length = reader.number(element, "length")
    if length < 0.0:
        raise reader.error(element, f"its length is {length}, it must not be negative")
    plan, lanes = element.find("planView"), element.find("lanes")
    if plan is None or lanes is None:
        missing = "planView" if plan is None else "lanes"
        raise reader.error(element, f"it has no <{missing}>")
    geometries = [_read_geometry(reader, geometry) for geometry in plan.iterchildren("geometry")]
    if not geometries:
        raise reader.error(plan, "its <planView> has no <geometry>")
    rule = element.get("rule", "RHT")
    if rule not in ("RHT", "LHT"):
        raise reader.error(element, f"its rule is {rule!r}, it must be RHT or LHT")
    return Road(
        id=reader.road,
        name=element.get("name") or f"road {reader.road}",
        length=length,
        junction=element.get("junction", "-1"),
        left_hand_traffic=rule == "LHT",
        predecessor=_read_link(reader, element.find("link/predecessor")),
        successor=_read_link(reader, element.find("link/successor")),
        speeds=[
            reader.speed(speed, reader.number(kind, "s"))
            for kind in element.iterchildren("type")
            for speed in kind.iterchildren("speed")
        ],
        geometries=sorted(geometries, key=lambda geometry: geometry.s),
        elevations=reader.cubics(element.iterfind("elevationProfile/elevation"), "s", 0.0),
        offsets=reader.cubics(lanes.iterchildren("laneOffset"), "s", 0.0),
        sections=read_sections(reader, lanes, length),
        signals=[
            _read_signal(reader, signal)
            for signal in element.iterfind("signals/signal")
            if signal.get("type") == TRAFFIC_LIGHT and signal.get("dynamic") == "yes"
        ],
        line=element.sourceline or 0,
    )


def _read_link(reader: Reader, element: etree._Element | None) -> RoadLink | None:
    if element is None:
        return None
    kind = reader.text(element, "elementType")
    if kind not in ("road", "junction"):
        raise reader.error(element, f"elementType is {kind!r}, it must be road or junction")
    contact = _contact(reader, element) if kind == "road" else ""
    return RoadLink(kind == "junction", reader.text(element, "elementId"), contact, element.sourceline or 0)


def _contact(reader: Reader, element: etree._Element) -> str:
    contact = reader.text(element, "contactPoint")
    if contact not in ("start", "end"):
        raise reader.error(element, f"contactPoint is {contact!r}, it must be start or end")
    return contact


def _read_geometry(reader: Reader, element: etree._Element) -> Geometry:
    shapes = [child for child in element if child.tag in _GEOMETRIES]
    if len(shapes) != 1:
        kinds = ", ".join(_GEOMETRIES)
        raise reader.error(element, f"a <geometry> must be one of: {kinds}")
    shape = shapes[0]
    parameters = [reader.number(shape, name) for name in _GEOMETRIES[shape.tag]]
    length = reader.number(element, "length")
    if length < 0.0:
        raise reader.error(element, f"the geometry's length is {length}, it must not be negative")
    if shape.tag == "paramPoly3":
        span = shape.get("pRange", "arcLength")
        if span not in ("arcLength", "normalized"):
            raise reader.error(shape, f"pRange is {span!r}, it must be arcLength or normalized")
        parameters.append(1.0 if span == "normalized" else 0.0)
    return Geometry(
        s=reader.number(element, "s"),
        x=reader.number(element, "x"),
        y=reader.number(element, "y"),
        heading=reader.number(element, "hdg"),
        length=length,
        kind=shape.tag,
        parameters=tuple(parameters),
        line=element.sourceline or 0,
    )


def _read_signal(reader: Reader, element: etree._Element) -> Signal:
    lanes = tuple(
        (reader.whole(valid, "fromLane"), reader.whole(valid, "toLane"))
        for valid in element.iterchildren("validity")
    )
    return Signal(
        id=reader.text(element, "id"),
        s=reader.number(element, "s"),
        orientation=element.get("orientation", "none"),
        lanes=tuple((min(pair), max(pair)) for pair in lanes),
        line=element.sourceline or 0,
    )


def _read_junction(reader: Reader, element: etree._Element) -> JunctionRecord:
    connections = []
    for connection in element.iterchildren("connection"):
        if connection.get("connectingRoad") is None:
            continue  # A direct or virtual connection has no road of its own.
        links = tuple(
            (reader.whole(link, "from"), reader.whole(link, "to"), link.sourceline or 0)
            for link in connection.iterchildren("laneLink")
        )
        connections.append(
            Connection(
                reader.text(connection, "incomingRoad"),
                reader.text(connection, "connectingRoad"),
                _contact(reader, connection),
                links,
                connection.sourceline or 0,
            )
        )
    return JunctionRecord(
        id=reader.text(element, "id"),
        name=element.get("name") or f"junction {element.get('id')}",
        connections=connections,
        priorities=[
            (reader.text(priority, "high"), reader.text(priority, "low"))
            for priority in element.iterchildren("priority")
        ],
        controllers=[reader.text(item, "id") for item in element.iterchildren("controller")],
        line=element.sourceline or 0,
    )
