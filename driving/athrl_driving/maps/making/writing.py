"""Write a plan as an OpenDRIVE 1.6 file: ordered, rounded, so that the same plan gives the same bytes."""

import xml.etree.ElementTree as ElementTree
from xml.etree.ElementTree import Element, SubElement

from athrl_driving.maps.making.curves import Piece
from athrl_driving.maps.making.plan import JunctionPlan, LanePlan, RoadPlan, SectionPlan, SignalPlan, TownPlan

_DECIMALS = 10
_TRAFFIC_LIGHT = "1000001"
_MARK_COLOUR = {True: "yellow", False: "white"}


def opendrive_text(plan: TownPlan) -> str:
    """Return the file's text."""
    root = Element("OpenDRIVE")
    _write_header(root, plan)
    for road in sorted(plan.roads, key=lambda road: road.number):
        _write_road(root, road)
    for controller in plan.controllers:
        element = SubElement(root, "controller", id=str(controller.number), name=controller.name)
        for signal in controller.signals:
            SubElement(element, "control", signalId=str(signal), type="0")
    for junction in plan.junctions:
        _write_junction(root, junction)
    ElementTree.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _number(value: float) -> str:
    text = f"{value:.{_DECIMALS}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _write_header(root: Element, plan: TownPlan) -> None:
    starts = [piece.at(s) for road in plan.roads for piece in road.pieces for s in (0.0, piece.length)]
    SubElement(
        root,
        "header",
        revMajor="1",
        revMinor="6",
        name=plan.name,
        version="1",
        north=f"{max(pose.y for pose in starts):.1f}",
        south=f"{min(pose.y for pose in starts):.1f}",
        east=f"{max(pose.x for pose in starts):.1f}",
        west=f"{min(pose.x for pose in starts):.1f}",
        vendor="athrl",
    )


def _write_road(root: Element, road: RoadPlan) -> None:
    element = SubElement(
        root,
        "road",
        name=road.name,
        length=_number(road.length),
        id=str(road.number),
        junction=str(road.junction),
        rule="RHT",
    )
    link = SubElement(element, "link")
    for side, target in (("predecessor", road.predecessor), ("successor", road.successor)):
        if target is not None:
            kind, number, contact = target
            attributes = {"elementType": kind, "elementId": str(number)}
            SubElement(link, side, attributes | ({"contactPoint": contact} if contact else {}))
    road_type = SubElement(element, "type", s="0", type=road.kind)
    SubElement(road_type, "speed", max=str(road.mph), unit="mph")
    plan_view = SubElement(element, "planView")
    position = 0.0
    for piece in road.pieces:
        _write_piece(plan_view, piece, position)
        position += piece.length
    if road.elevation:
        profile = SubElement(element, "elevationProfile")
        for start, *terms in road.elevation:
            values = {name: _number(term) for name, term in zip("abcd", terms, strict=True)}
            SubElement(profile, "elevation", {"s": _number(start)} | values)
    lanes = SubElement(element, "lanes")
    if road.lane_offset != 0.0:
        SubElement(lanes, "laneOffset", s="0", a=_number(road.lane_offset), b="0", c="0", d="0")
    ends = [section.start for section in road.sections[1:]] + [road.length]
    for section, end in zip(road.sections, ends, strict=True):
        _write_section(lanes, section, end - section.start)
    if road.signals:
        signals = SubElement(element, "signals")
        for signal in road.signals:
            _write_signal(signals, signal)


def _write_piece(plan_view: Element, piece: Piece, position: float) -> None:
    geometry = SubElement(
        plan_view,
        "geometry",
        s=_number(position),
        x=_number(piece.start.x),
        y=_number(piece.start.y),
        hdg=_number(piece.start.heading),
        length=_number(piece.length),
    )
    if piece.curvature == 0.0:
        SubElement(geometry, "line")
    else:
        SubElement(geometry, "arc", curvature=f"{piece.curvature:.14f}")


def _write_section(lanes: Element, section: SectionPlan, length: float) -> None:
    element = SubElement(lanes, "laneSection", s=_number(section.start))
    left = sorted((lane for lane in section.lanes if lane.number > 0), key=lambda lane: -lane.number)
    right = sorted((lane for lane in section.lanes if lane.number < 0), key=lambda lane: -lane.number)
    if left:
        _write_lanes(SubElement(element, "left"), left, length)
    centre = SubElement(SubElement(element, "center"), "lane", id="0", type="none", level="false")
    _write_mark(centre, section.centre_mark, "none", yellow=True)
    if right:
        _write_lanes(SubElement(element, "right"), right, length)


def _write_lanes(side: Element, lanes: list[LanePlan], length: float) -> None:
    for lane in lanes:
        element = SubElement(side, "lane", id=str(lane.number), type=lane.kind, level="false")
        if lane.predecessor is not None or lane.successor is not None:
            link = SubElement(element, "link")
            if lane.predecessor is not None:
                SubElement(link, "predecessor", id=str(lane.predecessor))
            if lane.successor is not None:
                SubElement(link, "successor", id=str(lane.successor))
        end_width = lane.width if lane.end_width is None else lane.end_width
        slope = (end_width - lane.width) / length
        SubElement(element, "width", sOffset="0", a=_number(lane.width), b=_number(slope), c="0", d="0")
        _write_mark(element, lane.mark, lane.change, yellow=False)


def _write_mark(lane: Element, mark: str, change: str, yellow: bool) -> None:
    attributes = {"sOffset": "0", "type": mark, "color": _MARK_COLOUR[yellow]}
    if mark != "none":
        attributes["width"] = "0.15"
    SubElement(lane, "roadMark", attributes | {"laneChange": change})


def _write_signal(signals: Element, signal: SignalPlan) -> None:
    element = SubElement(
        signals,
        "signal",
        s=_number(signal.position),
        t=_number(signal.lateral),
        id=str(signal.number),
        name=signal.name,
        dynamic="yes",
        orientation=signal.orientation,
        zOffset="3",
        country="OpenDRIVE",
        type=_TRAFFIC_LIGHT,
        subtype="-1",
        height="1",
        width="0.4",
    )
    SubElement(element, "validity", fromLane=str(signal.from_lane), toLane=str(signal.to_lane))


def _write_junction(root: Element, junction: JunctionPlan) -> None:
    element = SubElement(root, "junction", name=junction.name, id=str(junction.number), type="default")
    for index, connection in enumerate(junction.connections):
        entry = SubElement(
            element,
            "connection",
            id=str(index),
            incomingRoad=str(connection.incoming.road.number),
            connectingRoad=str(connection.road.number),
            contactPoint="start",
        )
        SubElement(entry, "laneLink", {"from": str(connection.incoming.number), "to": "-1"})
    for high, low in junction.priorities:
        SubElement(element, "priority", high=str(high), low=str(low))
    for sequence, controller in enumerate(junction.controllers):
        SubElement(element, "controller", id=str(controller), type="0", sequence=str(sequence))
