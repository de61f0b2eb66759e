"""Virtual junctions, where roads join a main road that goes on: driveways, car parks."""

from athrl_driving.maps.opendrive.model import OpenDrive, RoadLink


def leave_out_virtual_junctions(content: OpenDrive) -> None:
    """Remove the roads that lead to the middle of another road; the main road is driven as if alone.

    A vehicle from such a road would appear in the middle of the traffic: no lane of the main road ends there.
    """
    virtual = {junction.id: None for junction in content.junctions.values() if junction.type == "virtual"}
    if not virtual:
        return
    for identifier in virtual:
        junction = content.junctions.pop(identifier)
        content.findings.add(
            "a virtual junction was left out: its main road is driven, what joins it there is not",
            f"junction {identifier}, line {junction.line}",
            allowed=True,
        )
    removed = {road.id for road in content.roads.values() if road.junction in virtual}
    for identifier in removed:
        del content.roads[identifier]

    def kept(link: RoadLink | None) -> RoadLink | None:
        gone = link is not None and link.id in (virtual if link.is_junction else removed)
        return None if gone else link

    for road in content.roads.values():
        road.predecessor, road.successor = kept(road.predecessor), kept(road.successor)
