"""Reads junctions: common ones with connecting roads, and direct ones without."""

from __future__ import annotations

from athrl_spaces.untrusted import one_line
from lxml import etree  # type: ignore[import-untyped]

from athrl_driving.maps.opendrive.bounds import LONGEST_TEXT
from athrl_driving.maps.opendrive.element_reader import ElementReader
from athrl_driving.maps.opendrive.model import Connection, JunctionRecord, OpenDrive


def read_contact(reader: ElementReader, element: etree._Element) -> str:
    """Return "start" or "end", the end of a road that an element names."""
    contact = reader.text(element, "contactPoint")
    if contact not in ("start", "end"):
        raise reader.error(element, f"contactPoint is {contact!r}, it must be start or end")
    return contact


def read_junction(reader: ElementReader, content: OpenDrive, element: etree._Element) -> JunctionRecord:
    """Return a junction. Its boundary, surface, groups and paths for pedestrians are passed over."""
    identifier = reader.text(element, "id")
    return JunctionRecord(
        id=identifier,
        name=one_line(element.get("name") or "")[:LONGEST_TEXT] or f"junction {identifier}",
        type=element.get("type", "default"),
        connections=[
            _read_connection(reader, connection)
            for connection in element.iterchildren("connection")
            if _is_read(connection)
        ],
        priorities=[
            (reader.text(priority, "high"), reader.text(priority, "low"))
            for priority in element.iterchildren("priority")
            # Either may be missing: a road that goes before, or after, all others.
            if priority.get("high") is not None and priority.get("low") is not None
        ],
        controllers=[reader.text(item, "id") for item in element.iterchildren("controller")],
        line=element.sourceline or 0,
    )


def _is_read(connection: etree._Element) -> bool:
    """Tell whether a connection leads from a road to a road; virtual ones only say what could be driven."""
    leads = connection.get("connectingRoad") is not None or connection.get("linkedRoad") is not None
    return leads and connection.get("incomingRoad") is not None and connection.get("type") != "virtual"


def _read_connection(reader: ElementReader, element: etree._Element) -> Connection:
    attribute = "connectingRoad" if element.get("connectingRoad") is not None else "linkedRoad"
    links = element.findall("laneLink")
    return Connection(
        incoming=reader.text(element, "incomingRoad"),
        connecting=reader.text(element, attribute),
        contact=read_contact(reader, element) if element.get("contactPoint") is not None else "",
        lane_links=tuple(
            (reader.whole(link, "from"), reader.whole(link, "to"), link.sourceline or 0)
            for link in links
            # Lanes of the temporary layer (road works) are not read.
            if "temporary" not in (link.get("fromLayer"), link.get("toLayer"))
        )
        if links
        else None,
        line=element.sourceline or 0,
    )
