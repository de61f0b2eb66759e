"""All lanes of an OpenDRIVE file, linked: what the lane graph is made from."""

from collections import Counter
from dataclasses import dataclass

from athrl_driving.maps.opendrive.carriageways import Carriageway, carriageways_of
from athrl_driving.maps.opendrive.gaps import close_gaps
from athrl_driving.maps.opendrive.links import link_roads, link_within, road_ends
from athrl_driving.maps.opendrive.merging import merged
from athrl_driving.maps.opendrive.model import MapError, OpenDrive
from athrl_driving.maps.opendrive.unlinked import link_lanes_that_meet, note_roads_that_meet

_TYPES_NAMED = 5


@dataclass(frozen=True, slots=True)
class Roadway:
    """The carriageways of all roads, and what the file holds before anything is left out."""

    content: OpenDrive
    carriageways: list[Carriageway]
    lane_kilometres: float
    """Of all driving lanes, in junctions too, measured along the reference lines."""
    junction_arms: Counter[int]
    """How many junctions have how many arms; an arm is one end of a road."""


def build_roadway(content: OpenDrive) -> Roadway:
    """Return a file's driving lanes. Raises `MapError` where they cannot be driven on."""
    carriageways: list[Carriageway] = []
    metres = 0.0
    for road in content.roads.values():
        metres += sum(
            (section.end - section.s) * sum(lane.drives for lane in section.lanes.values())
            for section in road.sections
        )
        own = carriageways_of(content, road)
        link_within(content, road, own)
        carriageways += merged(own)
    if not carriageways:
        raise MapError(f"{content.name}: there is no driving lane in the file{_types_of_lanes(content)}")
    link_roads(content, road_ends(carriageways))
    link_lanes_that_meet(content, carriageways)
    note_roads_that_meet(content, carriageways)
    close_gaps(content, carriageways)
    return Roadway(content, carriageways, metres / 1000.0, _junction_arms(content))


def _types_of_lanes(content: OpenDrive) -> str:
    """Return what the lanes are that no car drives on, for an error; nothing where there are none."""
    sections = (section for road in content.roads.values() for section in road.sections)
    types = sorted({lane.type for section in sections for lane in section.lanes.values()})
    named = ", ".join(types[:_TYPES_NAMED]) + (", ..." if len(types) > _TYPES_NAMED else "")
    return f", only {named}" if types else ""


def _junction_arms(content: OpenDrive) -> Counter[int]:
    """Count for every junction the roads' ends with driving lanes that are linked to it."""
    arms = Counter(dict.fromkeys(content.junctions, 0))
    for road in content.roads.values():
        for link, section in ((road.predecessor, road.sections[0]), (road.successor, road.sections[-1])):
            drives = any(lane.drives for lane in section.lanes.values())
            if link is not None and link.is_junction and link.id in arms and drives:
                arms[link.id] += 1
    return Counter(arms.values())
