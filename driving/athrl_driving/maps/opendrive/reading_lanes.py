"""Reading a road's lane sections."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lxml import etree  # type: ignore[import-untyped]

from athrl_driving.maps.opendrive.model import Lane, LaneMark, LaneSection

if TYPE_CHECKING:
    from athrl_driving.maps.opendrive.reading import Reader

_LANE_CHANGES = {
    "both": (True, True),
    "increase": (True, False),
    "decrease": (False, True),
    "none": (False, False),
}
_CROSSED_TYPES = frozenset({"broken", "none", "broken broken", "botts dots"})
"""Marks that may be crossed where the file does not say whether."""


def read_sections(reader: Reader, lanes: etree._Element, length: float) -> list[LaneSection]:
    """Return a road's sections in order, each with its end."""
    sections = [_read_section(reader, element) for element in lanes.iterchildren("laneSection")]
    if not sections:
        raise reader.error(lanes, "its <lanes> has no <laneSection>")
    sections.sort(key=lambda section: section.s)
    for section, following in zip(sections, [*sections[1:], None], strict=True):
        section.end = length if following is None else following.s
        if section.end < section.s - 1e-6:
            raise reader.error(lanes, f"a <laneSection> starts at {section.s} m, the road ends at {length} m")
    return sections


def _read_section(reader: Reader, element: etree._Element) -> LaneSection:
    begin = reader.number(element, "s")
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
    return LaneSection(begin, begin, lanes, element.sourceline or 0)


def _read_lane(reader: Reader, element: etree._Element, begin: float) -> Lane:
    reader.lane = reader.whole(element, "id")
    widths = reader.cubics(element.iterchildren("width"), "sOffset", begin)
    borders = reader.cubics(element.iterchildren("border"), "sOffset", begin)
    lane = Lane(
        id=reader.lane,
        type=reader.text(element, "type"),
        direction=element.get("direction", "standard"),
        widths=widths,
        borders=borders,
        predecessors=[reader.whole(link, "id") for link in element.iterfind("link/predecessor")],
        successors=[reader.whole(link, "id") for link in element.iterfind("link/successor")],
        marks=[],
        speeds=[],
        line=element.sourceline or 0,
    )
    if not widths and not borders:
        raise reader.error(element, "it has neither <width> nor <border>")
    if (widths or borders)[0].s > begin + 0.01:
        raise reader.error(element, "its first <width> or <border> does not start with the section")
    if lane.drives:
        lane.marks = [_read_mark(reader, mark, begin) for mark in element.iterchildren("roadMark")]
        lane.speeds = [
            reader.speed(speed, begin + reader.number(speed, "sOffset"))
            for speed in element.iterchildren("speed")
        ]
    return lane


def _read_mark(reader: Reader, element: etree._Element, begin: float) -> LaneMark:
    change = element.get("laneChange")
    if change is None:
        allowed = element.get("type", "none") in _CROSSED_TYPES
        return LaneMark(begin + reader.number(element, "sOffset"), allowed, allowed)
    if change not in _LANE_CHANGES:
        raise reader.error(element, f"laneChange is {change!r}, it must be one of {', '.join(_LANE_CHANGES)}")
    return LaneMark(begin + reader.number(element, "sOffset"), *_LANE_CHANGES[change])
