"""Reads a road's lane sections."""

from __future__ import annotations

import itertools

from lxml import etree  # type: ignore[import-untyped]

from athrl_driving.maps.opendrive.borders import widths_from_borders
from athrl_driving.maps.opendrive.bounds import GAP, LARGEST_GAP, MOST_LANES_BESIDE
from athrl_driving.maps.opendrive.element_reader import ElementReader
from athrl_driving.maps.opendrive.model import Cubic, Lane, LaneMark, LaneSection
from athrl_driving.maps.opendrive.sections import with_both_sides, without_empty

_LANE_CHANGES = {
    "both": (True, True),
    "increase": (True, False),
    "decrease": (False, True),
    "none": (False, False),
}
_CROSSED_TYPES = frozenset({"broken", "none", "broken broken", "botts dots"})
"""Marks that may be crossed where the file does not say whether."""


def read_sections(reader: ElementReader, road: etree._Element, length: float) -> list[LaneSection]:
    """Return a road's sections in order, each with its end; one without lanes where the file has none."""
    elements = list(road.iterfind("lanes/laneSection"))
    sections = [_read_section(reader, element) for element in elements]
    if not sections:
        reader.note(road, "a road without lanes was left out")
        return [LaneSection(0.0, length, {}, road.sourceline or 0)]
    single = [element.get("singleSide") == "true" for element in elements]
    order = sorted(range(len(sections)), key=lambda place: sections[place].s)
    sections = with_both_sides([sections[place] for place in order], [single[place] for place in order])
    _begin_with_road(reader, road, sections[0])
    for section, following in itertools.zip_longest(sections, sections[1:]):
        section.end = length if following is None else following.s
        beyond = section.s - section.end
        if round(beyond, 3) > LARGEST_GAP:
            message = f"a <laneSection> starts at {section.s:.3f} m, the road ends at {length:.3f} m"
            raise reader.error(road, message)
        if beyond > GAP:
            reader.note(road, "a lane section behind the end of its road was passed over", beyond)
    return without_empty(sections)


def _begin_with_road(reader: ElementReader, road: etree._Element, first: LaneSection) -> None:
    """Let the first section begin at 0, as it must."""
    if round(abs(first.s), 3) > LARGEST_GAP:
        raise reader.error(road, f"its first <laneSection> starts at {first.s:.3f} m, it must start at 0 m")
    if abs(first.s) > GAP:
        reader.note(road, "a road's first lane section was taken to begin with the road", abs(first.s))
    first.s = 0.0


def _read_section(reader: ElementReader, element: etree._Element) -> LaneSection:
    begin = reader.station(element, "s")
    lanes: dict[int, Lane] = {}
    for side in element:
        if side.tag not in ("left", "right"):
            continue
        for child in side.iterchildren("lane"):
            lane = _read_lane(reader, child, begin)
            if lane.id == 0 or (lane.id > 0) != (side.tag == "left"):
                raise reader.error(child, f"a lane of <{side.tag}> has the id {lane.id}")
            if lane.id in lanes:
                raise reader.error(child, f"there are two lanes with the id {lane.id}")
            lanes[lane.id] = lane
            reader.lane = None
    if len(lanes) > MOST_LANES_BESIDE:
        message = (
            f"a <laneSection> has {len(lanes)} lanes, at most {MOST_LANES_BESIDE} may be beside each other"
        )
        raise reader.error(element, message)
    widths_from_borders(lanes)
    return LaneSection(begin, begin, lanes, element.sourceline or 0)


def _read_lane(reader: ElementReader, element: etree._Element, begin: float) -> Lane:
    reader.lane = reader.whole(element, "id")
    widths = reader.cubics(element.iterchildren("width"), "sOffset", begin)
    borders = reader.cubics(element.iterchildren("border"), "sOffset", begin)
    lane = Lane(
        id=reader.lane,
        type=reader.text(element, "type"),
        direction=element.get("direction", "standard"),
        widths=widths,
        borders=borders,
        predecessors=_read_links(reader, element, "link/predecessor"),
        successors=_read_links(reader, element, "link/successor"),
        marks=[],
        speeds=[],
        line=element.sourceline or 0,
    )
    _complete_widths(reader, element, lane, begin)
    if lane.drives:
        lane.marks = [_read_mark(reader, mark, begin) for mark in element.iterchildren("roadMark")]
        lane.speeds = [
            reader.speed(speed, begin + reader.offset(speed)) for speed in element.iterchildren("speed")
        ]
        lane.marks.sort(key=lambda mark: mark.s)
        lane.speeds.sort(key=lambda limit: limit.s)
    if max(len(lane.predecessors), len(lane.successors)) > MOST_LANES_BESIDE:
        raise reader.error(element, f"it is linked to more than {MOST_LANES_BESIDE} lanes")
    return lane


def _read_links(reader: ElementReader, lane: etree._Element, path: str) -> list[int]:
    links = list(lane.iterfind(path))
    named = [link for link in links if link.get("id")]
    if len(named) < len(links):
        reader.note(lane, "a link that does not say where it leads was passed over")
    return [reader.whole(link, "id") for link in named]


def _complete_widths(reader: ElementReader, element: etree._Element, lane: Lane, begin: float) -> None:
    """Let the lane have a width from the start of its section on."""
    records = lane.widths or lane.borders
    if not records:
        reader.note(element, "a lane without a width was taken as 0 m wide")
        lane.widths = [Cubic(begin, 0.0, 0.0, 0.0, 0.0, lane.line)]
        return
    late = records[0].s - begin
    if round(late, 3) > LARGEST_GAP and lane.widths:
        reader.note(element, "a lane whose first width starts late was taken as 0 m wide before it", late)
        lane.widths.insert(0, Cubic(begin, 0.0, 0.0, 0.0, 0.0, lane.line))
    elif round(late, 3) > LARGEST_GAP:
        message = f"its first <border> starts {late:.3f} m behind its section, it must start with it"
        raise reader.error(element, message)
    elif late > GAP:
        reader.note(element, "a lane's first width was taken from the start of its section on", late)


def _read_mark(reader: ElementReader, element: etree._Element, begin: float) -> LaneMark:
    change, s = element.get("laneChange"), begin + reader.offset(element)
    if change in _LANE_CHANGES:
        return LaneMark(s, *_LANE_CHANGES[change])
    if change is not None:
        reader.note(element, "a laneChange that does not exist was passed over")
    allowed = element.get("type", "none") in _CROSSED_TYPES
    return LaneMark(s, allowed, allowed)
