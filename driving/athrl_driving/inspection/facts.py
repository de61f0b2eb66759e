"""What a map's file holds, what of it vehicles drive on, and what is left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from athrl_driving.episode.room_for_vehicles import places_beside_an_ego
from athrl_driving.inspection.bends import Bends, bends_of
from athrl_driving.inspection.ways import mean_way
from athrl_driving.maps import Town
from athrl_driving.maps.findings import Findings
from athrl_driving.maps.lane_graph import Integers, LaneGraph
from athrl_driving.maps.outlines import outlines
from athrl_driving.maps.reachability import Edges, components


@dataclass(frozen=True)
class Driven:
    """What vehicles drive on."""

    lanes: int
    """Lanes of roads, counted by the ids of road and lane."""
    kilometres: float
    share: float
    """Of the length of all lanes that could be driven on, 0 to 1."""
    parts: tuple[float, ...]
    """km of lanes of each part, the largest first; no way and no change of lane leads from one to another."""
    ways_out: int
    """Lanes that end at the map's edge, where vehicles leave it; none on a closed map."""
    vehicle_places: int
    """Background vehicles for which there is room beside an ego."""
    light_groups: int
    """Groups of traffic lights that change together and that lanes heed."""
    light_lanes: int
    """Lanes that end at a stop line before a light; the picture has a dot at each."""
    mean_way: float
    """m that an episode from a random start can drive in the mean before the map ends: at most 400, for which
    it has time, and fewer on open maps."""


@dataclass(frozen=True)
class MapFacts:
    """What a map holds; as text the report on it, a line for each thing."""

    name: str
    opendrive: str
    """Revision, such as "1.6"; empty where the file does not tell."""
    roads: int
    lane_kilometres: float
    """Along the lanes where they are wide enough: of those that are driven on, and of those left out."""
    extent: tuple[float, float]
    """m from west to east and from south to north, of the lanes that are driven on with their width."""
    junction_arms: dict[int, int]
    """How many junctions have how many arms."""
    bends: Bends
    traffic_lights: int
    """In the file, those too that no lane heeds."""
    driven: Driven
    left_out: tuple[tuple[str, int, float], ...]
    """(road's name, lane's id, m), the longest first."""
    faults: tuple[str, ...]
    """One line for each kind of fault of the file that was mended or left out."""

    @property
    def metres_left_out(self) -> float:
        """Return the length of the lanes that are left out, m."""
        return sum(metres for *_, metres in self.left_out)


def facts_of(town: Town) -> MapFacts:
    """Return the facts of a town; nothing is driven for it."""
    driven, left_out = _driven(town), tuple(sorted(town.left_out, key=lambda lane: -lane[2]))
    return MapFacts(
        name=town.name,
        opendrive=town.revision,
        roads=town.roads,
        lane_kilometres=driven.kilometres + sum(metres for *_, metres in left_out) / 1000.0,
        extent=_extent(town),
        junction_arms=dict(sorted(town.junction_arms.items())),
        bends=bends_of(town),
        traffic_lights=town.traffic_lights,
        driven=driven,
        left_out=left_out,
        faults=_faults(town),
    )


def _extent(town: Town) -> tuple[float, float]:
    points = np.concatenate(outlines(town.lane_polylines(), town.graph.width))
    east, south = (points.max(axis=0) - points.min(axis=0)).tolist()
    return east, south


def _faults(town: Town) -> tuple[str, ...]:
    findings = Findings(town.name)
    for finding in town.findings:
        findings.add(finding.kind, finding.place, finding.metres)
    return tuple(line.removeprefix(f"{town.name}: ") for line in findings.lines())


def _driven(town: Town) -> Driven:
    # A lane through a junction is in the graph once for each movement, with the same index.
    _, first = np.unique([f"{index}" for index in town.lane_indices], return_index=True)
    metres = town.graph.length[first]
    part = np.array(components(_undirected(town.graph)))[first]
    lengths = np.bincount(part, weights=metres)
    total, left_out = float(metres.sum()), sum(length for *_, length in town.left_out)
    return Driven(
        lanes=len(set(zip(town.road_id, town.lane_id.tolist(), strict=True))),
        kilometres=total / 1000.0,
        share=total / (total + left_out),
        parts=tuple(sorted((lengths[lengths > 0.0] / 1000.0).tolist(), reverse=True)),
        ways_out=len(ways_out(town.graph)),
        vehicle_places=places_beside_an_ego(town),
        light_groups=len(town.signals.cycle),
        light_lanes=len(lanes_before_lights(town)),
        mean_way=mean_way(town),
    )


def lanes_before_lights(town: Town) -> Integers:
    """Return the lanes that end at a stop line before a light."""
    return np.unique(town.movements.origin[town.movements.signal >= 0])


def ways_out(graph: LaneGraph) -> Integers:
    """Return the lanes on which vehicles leave the map: nothing follows, and no lane beside them goes on."""
    return np.flatnonzero((np.diff(graph.successor_start) == 0) & ~graph.dead_end)


def _undirected(graph: LaneGraph) -> Edges:
    """Return for every lane those that follow it, lead to it, or can be changed to or from."""
    edges: Edges = [[] for _ in graph.length]
    count = np.diff(graph.successor_start)
    pairs = [(np.repeat(np.arange(len(count)), count), graph.successor)]
    pairs += [(np.flatnonzero(side >= 0), side[side >= 0]) for side in (graph.left, graph.right)]
    for origins, targets in pairs:
        for origin, target in zip(origins.tolist(), targets.tolist(), strict=True):
            edges[origin].append(target)
            edges[target].append(origin)
    return edges
