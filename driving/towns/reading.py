"""Read an OpenDRIVE file's lanes as lines to draw: straight reference lines and arcs, as in the towns here.

This is independent of the package's loader on purpose: pictures and tests show what lies in the file.
"""

import itertools
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

_STEP = 2.0
"""Metres between samples on arcs and where widths change."""


@dataclass(frozen=True)
class Lane:
    """One lane of one section; `left`, `middle` and `right` are points float64 [N, 3] x, y, elevation in m.

    They run in driving direction (right-hand traffic); `number` is OpenDRIVE's, `section` counts from 0.
    A lane `ends` where it goes on neither in the next section nor in another road.
    """

    road: str
    road_name: str
    section: int
    number: int
    kind: str
    junction: str
    road_kind: str
    mph: float
    mark: str
    ends: bool
    length: float
    left: np.ndarray
    middle: np.ndarray
    right: np.ndarray


@dataclass(frozen=True)
class Signal:
    """A dynamic signal: its road and where it stands, m."""

    road: str
    x: float
    y: float


@dataclass(frozen=True)
class Drawing:
    """All lanes and signals of a file, and its root element for whatever else is asked."""

    lanes: list[Lane]
    signals: list[Signal]
    root: Element


class ReferenceLine:
    """The line that a road's lanes are measured from, and the road's elevation."""

    def __init__(self, road: Element) -> None:
        self.pieces = [
            (
                *(float(piece.attrib[name]) for name in ("s", "x", "y", "hdg", "length")),
                float(arc.attrib["curvature"]) if (arc := piece.find("arc")) is not None else 0.0,
            )
            for piece in road.iterfind("planView/geometry")
        ]
        self.elevations = _cubics(road.iterfind("elevationProfile/elevation"), "s")
        self.offsets = _cubics(road.iterfind("lanes/laneOffset"), "s")

    def point(self, s: float, t: float) -> tuple[float, float, float]:
        """Return x, y, elevation at station `s`, `t` metres to the left."""
        x, y, heading = self.pose(s)
        return x - t * math.sin(heading), y + t * math.cos(heading), cubic_at(self.elevations, s)

    def pose(self, s: float) -> tuple[float, float, float]:
        """Return x, y, heading at station `s`."""
        start, x, y, heading, _, curvature = next(
            (piece for piece in reversed(self.pieces) if piece[0] <= s + 1e-9), self.pieces[0]
        )
        along, turned = s - start, curvature * (s - start)
        # The chord of an arc is its length times sin(half) / half, half-way turned.
        chord = along * float(np.sinc(turned / 2.0 / math.pi))
        direction = heading + turned / 2.0
        return x + chord * math.cos(direction), y + chord * math.sin(direction), heading + turned

    def stations(self, start: float, end: float) -> list[float]:
        """Return the stations between two to sample: piece ends, and steps where it is not straight."""
        result = {start, end}
        for first, _, _, _, length, curvature in self.pieces:
            count = max(math.ceil(length / _STEP), 1) if curvature or self.elevations[1:] else 1
            result |= {first + length * index / count for index in range(count + 1)}
        ordered = sorted(s for s in result if start <= s <= end)
        return [a for a, b in itertools.pairwise(ordered) if b - a > 1e-6] + [end]


def read(path: Path) -> Drawing:
    """Read a file. Raises `OSError` or `ParseError` where it cannot be read."""
    root = ElementTree.parse(path).getroot()
    lanes: list[Lane] = []
    signals: list[Signal] = []
    for road in root.iterfind("road"):
        line = ReferenceLine(road)
        lanes.extend(_lanes(road, line))
        for signal in road.iterfind("signals/signal"):
            if signal.get("dynamic") == "yes":
                x, y, _ = line.point(float(signal.attrib["s"]), float(signal.attrib["t"]))
                signals.append(Signal(road.attrib["id"], x, y))
    return Drawing(lanes, signals, root)


def links(drawing: Drawing) -> list[tuple[Lane, Lane]]:
    """Return the pairs of driving lanes of which the second follows the first, as the file links them."""
    lanes = {(lane.road, lane.section, lane.number): lane for lane in drawing.lanes if lane.kind == "driving"}
    roads = {road.attrib["id"]: road for road in drawing.root.iterfind("road")}
    result = []
    for lane in lanes.values():
        number, side = lane.number, "predecessor" if lane.number > 0 else "successor"
        section = roads[lane.road].findall("lanes/laneSection")[lane.section]
        following = lane.section + (1 if number < 0 else -1)
        for link in section.iterfind(f".//lane[@id='{number}']/link/{side}"):
            if (lane.road, following, int(link.attrib["id"])) in lanes:
                result.append((lane, lanes[lane.road, following, int(link.attrib["id"])]))
    for connection in drawing.root.iterfind("junction/connection"):
        incoming, road = connection.attrib["incomingRoad"], roads[connection.attrib["connectingRoad"]]
        before, after = road.find("link/predecessor"), road.find("link/successor")
        if before is None or after is None or before.get("elementId") != incoming:
            raise ValueError(f"connecting road {road.get('id')} is not linked to road {incoming}")
        for link in connection.iterfind("laneLink"):
            inside = lanes[road.attrib["id"], 0, int(link.attrib["to"])]
            inner = road.find(f".//lane[@id='{inside.number}']/link/successor")
            if inner is None:
                raise ValueError(f"connecting road {road.get('id')} has a lane without a successor")
            result.append((lanes[_end(roads, before, int(link.attrib["from"]))], inside))
            result.append((inside, lanes[_end(roads, after, int(inner.attrib["id"]))]))
    return result


def _end(roads: dict[str, Element], link: Element, number: int) -> tuple[str, int, int]:
    """Return road, section and number of the lane that a connecting road is linked to."""
    road = link.attrib["elementId"]
    sections = len(roads[road].findall("lanes/laneSection"))
    return road, sections - 1 if link.get("contactPoint") == "end" else 0, number


def _lanes(road: Element, line: ReferenceLine) -> list[Lane]:
    result = []
    sections = road.findall("lanes/laneSection")
    starts = [float(section.attrib["s"]) for section in sections]
    kind = road.find("type")
    speed = road.find("type/speed")
    for index, section in enumerate(sections):
        start, end = starts[index], (*starts[1:], float(road.attrib["length"]))[index]
        if end - start < 1e-6:
            continue
        stations = line.stations(start, end)
        for side in (1, -1):
            edge = np.array([cubic_at(line.offsets, s) for s in stations])
            numbered = {int(lane.attrib["id"]): lane for lane in section.iter("lane")}
            for number in sorted((n for n in numbered if n * side > 0), key=abs):
                lane = numbered[number]
                widths = _cubics(lane.iterfind("width"), "sOffset")
                outer = edge + side * np.array([cubic_at(widths, s - start) for s in stations])
                inside, middle, outside = (
                    np.array([line.point(s, t) for s, t in zip(stations, side_line, strict=True)])
                    for side_line in (edge, (edge + outer) / 2.0, outer)
                )
                edge = outer
                mark = lane.find("roadMark")
                direction = -side
                result.append(
                    Lane(
                        road=road.attrib["id"],
                        road_name=road.get("name", ""),
                        section=index,
                        number=number,
                        kind=lane.attrib["type"],
                        junction=road.get("junction", "-1"),
                        road_kind="" if kind is None else kind.get("type", ""),
                        mph=0.0 if speed is None else float(speed.attrib["max"]),
                        mark="none" if mark is None else mark.get("type", "none"),
                        ends=_ends(lane, last=index == (len(sections) - 1 if side < 0 else 0)),
                        length=end - start,
                        left=inside[::direction],
                        middle=middle[::direction],
                        right=outside[::direction],
                    )
                )
    return result


def _ends(lane: Element, last: bool) -> bool:
    """Return whether a lane ends in the middle of its road."""
    side = "predecessor" if int(lane.attrib["id"]) > 0 else "successor"
    return not last and lane.find(f"link/{side}") is None


def _cubics(elements: Iterable[Element], start: str) -> list[tuple[float, ...]]:
    result = [
        tuple(float(element.attrib[name]) for name in (start, "a", "b", "c", "d")) for element in elements
    ]
    return result or [(0.0, 0.0, 0.0, 0.0, 0.0)]


def cubic_at(cubics: list[tuple[float, ...]], s: float) -> float:
    """Return the value at `s` of cubics (start, a, b, c, d) in the order of their starts."""
    start, a, b, c, d = next((cubic for cubic in reversed(cubics) if cubic[0] <= s + 1e-9), cubics[0])
    along = s - start
    return a + along * (b + along * (c + along * d))
