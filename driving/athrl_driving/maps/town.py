"""A town, ready to be driven in, and the towns by name."""

import logging
import os
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from athrl_spaces import RANDOM_TOWNS, TOWNS, is_town, nearest_town, town_seed
from athrl_spaces.untrusted import one_line, parser_errors
from athrl_spaces.wording import counted
from numpy.typing import NDArray

from athrl_driving.maps.conflicts import relations_of
from athrl_driving.maps.crossings import make_junctions_of_crossings, note_crossings
from athrl_driving.maps.findings import Finding
from athrl_driving.maps.junctions import Junction, number_junctions
from athrl_driving.maps.lane_graph import LaneGraph, Movements, Signals
from athrl_driving.maps.lane_graph_builder import build_graph, build_movements, number_lanes
from athrl_driving.maps.lying_over import note_lanes_lying_over
from athrl_driving.maps.making.random_towns import checksum, lay_random_town
from athrl_driving.maps.making.writing import opendrive_text
from athrl_driving.maps.network import TownNetwork, build_network
from athrl_driving.maps.opendrive import MapError, OpenDrive, parse_opendrive, read_opendrive
from athrl_driving.maps.opendrive.bounds import LARGEST_HEIGHT_RANGE
from athrl_driving.maps.opendrive.carriageways import LaneSegment
from athrl_driving.maps.opendrive.roadway import Roadway, build_roadway
from athrl_driving.maps.outlines import LaneShapes, centre_lines
from athrl_driving.maps.priority import priorities, ring_segments, turn_of, yielding_movements
from athrl_driving.maps.reachability import Drivable, drivable_part
from athrl_driving.maps.road_names import told_names
from athrl_driving.maps.short_ends import prolong_short_ends, settle_short_ends
from athrl_driving.maps.signals import signals_of
from athrl_driving.maps.standing_segments import (
    all_segments,
    find_movements,
    make_junctions_of_forks,
    skip_very_short,
    standing_segments,
)
from athrl_driving.maps.town_file import TownFile, town_file

_FOLDER = Path(__file__).resolve().parent / "towns"

LEFT_OUT_SHARE = 0.02
"""Of all driving metres: where more is left out, it is a warning."""

_ROADS_NAMED = 5
_LONGEST_NAME = 100
"""Characters of a town's name that an error tells: somebody may give a file's text for its name."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Town:
    """A town: highway-env's network and the arrays are two views of the same lanes."""

    name: str
    revision: str
    """Of OpenDRIVE, as the file tells it, such as "1.6"; empty where it does not."""
    network: TownNetwork
    graph: LaneGraph
    movements: Movements
    signals: Signals
    lane_indices: list[tuple[str, str, int]]
    """By lane of the graph: highway-env's lane index; copies of a lane share one."""
    road_name: tuple[str, ...]
    """By lane of the graph: the name of its road in the map's file, "road ID" where it has none."""
    road_id: tuple[str, ...]
    """By lane of the graph: the id of its road; roads of one file may share a name."""
    lane_id: NDArray[np.int64]
    """By lane of the graph: the id on that road in the map's file."""
    junctions: tuple[Junction, ...]
    """By junction number; junctions that a movement crosses without a place to stand between are one."""
    roads: int
    """How many roads the file has, connecting roads in junctions too."""
    traffic_lights: int
    """How many traffic lights the file has, those too that no lane heeds."""
    lane_kilometres: float
    """Of all driving lanes in the file, those in junctions too, before anything was left out."""
    junction_arms: Counter[int]
    """How many junctions in the file have how many arms (ends of roads with driving lanes)."""
    left_out: tuple[tuple[str, int, float], ...]
    """Driving lanes that lead nowhere or cannot be reached: (road's name, lane id, m).

    Where roads share a name, it is followed by the id: "Main Street (road 7)".
    """
    left_out_shapes: LaneShapes
    """Where the lanes lie that are left out."""
    findings: tuple[Finding, ...]
    """Faults of the file that were bridged or left out."""
    file: TownFile | None = None
    """What it was read from; None if it was built by `build_town` alone."""

    def __reduce__(self) -> tuple:
        """Pickle the name and the checksum of the file, from which the copy's process loads the town again.

        Raises `MapError` for a town that was not read from a file.
        """
        if self.file is None:
            raise MapError(f"the town {self.name!r} cannot be pickled: it was not read from a file")
        return load_same_town, (self.file,)

    def __copy__(self) -> "Town":
        """Return the same town, as nothing in it changes."""
        return self

    def __deepcopy__(self, memo: dict) -> "Town":
        """Return the same town, as nothing in it changes."""
        return self

    def lane_called(self, lane: int) -> str:
        """Return what messages call a lane of the graph."""
        told = told_names(zip(self.road_id, self.road_name, strict=True))
        return f"lane {self.lane_id[lane]} of {told[self.road_id[lane]]}"

    @property
    def lane_shapes(self) -> LaneShapes:
        """The centre line of every lane of the graph."""
        graph = self.graph
        return LaneShapes(graph.start_x, graph.start_y, graph.start_heading, graph.curvature, graph.length)

    def lane_polylines(self, spacing: float = 2.0) -> list[NDArray[np.float64]]:
        """Return the centre line of every lane as points [n, 2] in metres, at most `spacing` metres apart."""
        return centre_lines(self.lane_shapes, spacing)


def load_town(name: str | os.PathLike[str], *, strict: bool = False) -> Town:
    """Return a town by name, or read it from an OpenDRIVE file (a path that ends in .xodr or .XODR).

    `random-7` is the random town of seed 7. A process reads a file once, and again when it has changed. Small
    faults of a file are bridged or left out, warned of and listed in `Town.findings`; with `strict` the first
    one is an error. Raises `ValueError` with one line: the known towns, or for a file what is wrong on which
    road, lane and line.
    """
    seed = town_seed(str(name))
    if seed is not None:
        return _random_town(seed)
    path = _FOLDER / f"{name}.xodr"
    if str(name).lower().endswith(".xodr"):
        path = Path(name)
    elif str(name) not in TOWNS:
        _refuse_other_file(Path(name))
        near = nearest_town(str(name))
        hint = f", did you mean {near!r}?" if near else "."
        told = str(name) if len(str(name)) <= _LONGEST_NAME else f"{str(name)[:_LONGEST_NAME]}..."
        raise MapError(
            f"there is no town named {told!r}{hint} "
            f"There are {', '.join(TOWNS)}, {RANDOM_TOWNS}; a file is given by its path (.xodr)"
        )
    return _load_file(path, strict)


def _refuse_other_file(path: Path) -> None:
    """Raise `MapError` where what is no town's name is something on the disk."""
    try:
        folder, file = path.is_dir(), path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        return
    if folder:
        raise MapError(f"{one_line(str(path))}: is a folder, should be a map's file (.xodr)")
    if file:
        raise MapError(f"{one_line(str(path))}: the name of a map's file ends in .xodr")


def _load_file(path: Path, strict: bool) -> Town:
    try:
        path = path.expanduser().resolve(strict=True)
        state = path.stat()
    except (OSError, RuntimeError, ValueError):  # also a user's home that is not there, and a NUL in the name
        raise MapError(f"{one_line(str(path))}: there is no such file") from None
    # A copy may keep the time of the original, which is not that of the file's own change.
    changed = (state.st_mtime_ns, state.st_ctime_ns, state.st_ino, state.st_size)
    return _read_town(path, changed, strict)


def load_same_town(file: TownFile) -> Town:
    """Load a town again that was pickled, maybe by another process on another machine.

    Raises `MapError` in one line where its file is not there or has become another one.
    """
    if is_town(file.name):
        town = load_town(file.name, strict=file.strict)
    else:  # a path as it was resolved: a link that ends in .xodr may lead to a file with another name
        town = _load_file(Path(file.name), file.strict)
    assert town.file is not None  # as it was loaded
    if town.file.checksum != file.checksum:
        raise MapError(
            f"{file.name} is another map than the one that was pickled "
            f"(SHA-256 {town.file.short_checksum}, should be {file.short_checksum})"
        )
    return town


@lru_cache(maxsize=16)
def _read_town(path: Path, _changed: tuple[int, ...], strict: bool) -> Town:
    town = _built(path.stem, one_line(path.name), lambda: read_opendrive(path, strict))
    return replace(town, file=town_file(town.name if path.parent == _FOLDER else str(path), path, strict))


@lru_cache(maxsize=16)
def _random_town(seed: int) -> Town:
    plan = lay_random_town(seed)
    name, text = plan.name, opendrive_text(plan).encode()
    town = _built(name, name, lambda: parse_opendrive(name, text, strict=True))
    return replace(town, file=TownFile(name, checksum(seed), strict=True))


def _built(name: str, told: str, read: Callable[[], OpenDrive]) -> Town:
    """Build the town of what `read` returns; errors call it `told`."""
    with (
        parser_errors(lambda reason: MapError(f"{told}: {reason}")),
        np.errstate(over="raise", divide="raise", invalid="raise"),
    ):
        return build_town(name, build_roadway(read()))


def build_town(name: str, roadway: Roadway) -> Town:
    """Build a town from lanes. Raises `ValueError` where none can be driven on or they are too many."""
    content, carriageways = roadway.content, roadway.carriageways
    skip_very_short(carriageways)
    make_junctions_of_forks(carriageways)
    crossings = make_junctions_of_crossings(carriageways)
    prolong_short_ends(carriageways)
    segments = all_segments(carriageways)
    standing = standing_segments(content.name, segments)
    drivable = drivable_part(carriageways, standing, find_movements(segments, standing))
    numbering = number_lanes(drivable)
    _check_drivable(content.name, drivable)
    _check_height_range(content.name, drivable)
    kept = set(numbering.segments)
    lost = [segment for segment in segments if segment not in kept]
    settle_short_ends(content.findings, dict.fromkeys(numbering.segments), lost)
    left_out = _left_out(content, lost)
    # Only of what is driven on: a road that is left out is in nobody's way.
    note_crossings(content.findings, crossings, kept)
    note_lanes_lying_over(content.findings, [segment for segment in segments if segment in kept])
    relations = relations_of(drivable.movements)
    turns = np.array([turn_of(movement) for movement in drivable.movements], dtype=np.int64)
    ring = ring_segments(list(dict.fromkeys(numbering.segments)))
    yields = yielding_movements(content, drivable.movements, relations, ring)
    junctions, junction_of = number_junctions(content, drivable.movements, ring, yields)
    signals, signal = signals_of(content, drivable.movements, junction_of, relations.conflicts)
    graph = build_graph(drivable, numbering, junction_of, turns)
    network, indices = build_network(drivable, numbering, graph)
    _report(content.name, drivable, left_out, sum(segment.length for segment in segments))
    content.findings.warn()
    return Town(
        name=name,
        revision=content.revision,
        network=network,
        graph=graph,
        movements=build_movements(
            drivable, numbering, relations, yields, priorities(drivable.movements, turns, yields), signal
        ),
        signals=signals,
        lane_indices=indices,
        road_name=tuple(segment.carriageway.road.name for segment in numbering.segments),
        road_id=tuple(segment.carriageway.road.id for segment in numbering.segments),
        lane_id=np.array([segment.lane.id for segment in numbering.segments], dtype=np.int64),
        junctions=junctions,
        roads=len(content.roads),
        traffic_lights=len({signal.id for road in content.roads.values() for signal in road.signals}),
        lane_kilometres=roadway.lane_kilometres,
        junction_arms=roadway.junction_arms,
        left_out=left_out,
        left_out_shapes=_shapes(lost),
        findings=tuple(content.findings),
    )


def _check_height_range(name: str, drivable: Drivable) -> None:
    """Raise `MapError` where lanes lie too far above each other."""
    heights = [height for each in drivable.segments for height in (each.elevation, each.end_elevation)]
    low, high = min(heights), max(heights)
    if high - low > LARGEST_HEIGHT_RANGE:
        most = f"at most {LARGEST_HEIGHT_RANGE:,.0f} m may be between them"
        raise MapError(f"{name}: its lanes lie from {low:,.0f} to {high:,.0f} m high, {most}")


def _check_drivable(name: str, drivable: Drivable) -> None:
    if not drivable.segments:
        raise MapError(
            f"{name}: its driving lanes lead to no loop and from no edge of the map to another: "
            "no vehicle could drive on"
        )


def _left_out(content: OpenDrive, lost: list[LaneSegment]) -> tuple[tuple[str, int, float], ...]:
    told = told_names((road.id, road.name) for road in content.roads.values())
    metres: dict[tuple[str, int], float] = defaultdict(float)
    for segment in lost:
        metres[told[segment.carriageway.road.id], segment.lane.id] += segment.length
    return tuple((road, lane, length) for (road, lane), length in metres.items())


def _shapes(segments: list[LaneSegment]) -> LaneShapes:
    columns = ([getattr(segment, name) for segment in segments] for name in LaneShapes._fields)
    return LaneShapes(*(np.array(column, dtype=np.float64) for column in columns))


def _report(
    name: str, drivable: Drivable, left_out: tuple[tuple[str, int, float], ...], metres: float
) -> None:
    """Log what is not driven on; `metres` is the length of all driving lanes."""
    for road, lane, length in left_out:
        _log.debug("%s: %s, lane %d: %.1f m left out", name, road, lane, length)
    if left_out:
        lost = sum(length for *_, length in left_out)
        _log.log(
            logging.WARNING if lost > LEFT_OUT_SHARE * metres else logging.INFO,
            "%s: %.1f m of %s (%.1f %%) left out, as they lead nowhere or nothing leads there: %s",
            name,
            lost,
            counted(len(left_out), "lane"),
            100.0 * lost / metres,
            _names(sorted({road for road, *_ in left_out})),
        )
    if drivable.leaves:
        _log.info(
            "%s: its roads end at the edge: vehicles enter on %s and leave on %d",
            name,
            counted(len(drivable.enters), "lane"),
            len(drivable.leaves),
        )
    if drivable.opened:
        _log.info("%s: %s of lane allowed against the marks", name, counted(drivable.opened, "change"))


def _names(roads: list[str]) -> str:
    """The roads' names, the first few of many."""
    more = f" and {len(roads) - _ROADS_NAMED} more" if len(roads) > _ROADS_NAMED else ""
    return ", ".join(roads[:_ROADS_NAMED]) + more
