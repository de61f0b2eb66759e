"""A town, ready to be driven in, and the towns by name."""

import difflib
import logging
import os
from collections import Counter, defaultdict
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.assembly import Rows, build_graph, build_movements, number_rows
from athrl_driving.maps.conflicts import relations_of
from athrl_driving.maps.junctions import Junction, number_junctions
from athrl_driving.maps.lane_graph import LaneGraph, Movements, Signals
from athrl_driving.maps.network import TownNetwork, build_network
from athrl_driving.maps.opendrive import MapError, read_opendrive
from athrl_driving.maps.opendrive.roadway import Roadway, lay_roadway
from athrl_driving.maps.priority import priorities, ring_pieces, turn_of, yielding_ways
from athrl_driving.maps.reachability import Drivable, drivable_part
from athrl_driving.maps.signals import signals_of
from athrl_driving.maps.stretches import (
    all_pieces,
    find_ways,
    make_junctions_of_forks,
    skip_very_short,
    standing_pieces,
)

_FOLDER = Path(__file__).parent / "towns"

TOWNS: tuple[str, ...] = tuple(sorted(path.stem for path in _FOLDER.glob("*.xodr")))
"""The names of the towns that the project ships."""

_ROADS_NAMED = 5

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Town:
    """A town: highway-env's network and the arrays are two views of the same lanes."""

    name: str
    network: TownNetwork
    graph: LaneGraph
    movements: Movements
    signals: Signals
    lane_indices: list[tuple[str, str, int]]
    """Row of the graph -> highway-env's lane index; several rows may share one."""
    road_name: tuple[str, ...]
    """Row of the graph -> the name of its road in the map's file."""
    lane_id: NDArray[np.int64]
    """Row of the graph -> its lane's id on that road."""
    junctions: tuple[Junction, ...]
    """By junction number; junctions that a way crosses without a place to stand between are one."""
    lane_kilometres: float
    """Of all driving lanes in the file, ways through junctions too, before anything was left out."""
    junction_arms: Counter[int]
    """How many junctions in the file have how many arms (ends of roads with driving lanes)."""
    left_out: tuple[tuple[str, int, float], ...]
    """Driving lanes that lead nowhere or cannot be reached: (road's name, lane id, m)."""

    def lane_polylines(self, spacing: float = 2.0) -> list[NDArray[np.float64]]:
        """Return the centre line of every row as points [n, 2] in metres, at most `spacing` metres apart."""
        graph, lines = self.graph, []
        for row, length in enumerate(graph.length.tolist()):
            straight = graph.curvature[row] == 0.0 or length <= spacing
            s = np.linspace(0.0, length, 2 if straight else int(np.ceil(length / spacing)) + 1)
            half = 0.5 * graph.curvature[row] * s
            # The chord of an arc: its length is s * sinc(half the turn), its direction half the turn.
            chord, direction = s * np.sinc(half / np.pi), graph.start_heading[row] + half
            x = graph.start_x[row] + chord * np.cos(direction)
            y = graph.start_y[row] + chord * np.sin(direction)
            lines.append(np.stack([x, y], axis=1))
        return lines


def load_town(name: str | os.PathLike[str]) -> Town:
    """Return a town by name, or read it from an OpenDRIVE file (a path that ends in .xodr).

    A file is read once a process, and again when it has changed. Raises `ValueError` with one line: the towns
    there are, or for a file what is wrong on which road, lane and line.
    """
    path = _FOLDER / f"{name}.xodr"
    if str(name).endswith(".xodr"):
        path = Path(name)
    elif str(name) not in TOWNS:
        near = difflib.get_close_matches(str(name).lower(), TOWNS, n=1)
        hint = f", did you mean {near[0]!r}?" if near else "."
        raise MapError(
            f"there is no town named {str(name)!r}{hint} "
            f"There are {', '.join(TOWNS)}; a file is given by its path (.xodr)"
        )
    try:
        path = path.expanduser().resolve(strict=True)
        changed = path.stat().st_mtime_ns
    except OSError:
        raise MapError(f"{path}: there is no such file") from None
    return _read_town(path, changed)


@lru_cache(maxsize=16)
def _read_town(path: Path, _changed: int) -> Town:
    return build_town(path.stem, lay_roadway(read_opendrive(path)))


def build_town(name: str, roadway: Roadway) -> Town:
    """Build a town from lanes. Raises `MapError` where they do not lead to each other."""
    content, strips = roadway.content, roadway.strips
    skip_very_short(strips)
    make_junctions_of_forks(strips)
    pieces = all_pieces(strips)
    standing = standing_pieces(pieces)
    drivable = drivable_part(strips, standing, find_ways(pieces, standing))
    rows = number_rows(drivable)
    _check_drivable(content.name, drivable)
    left_out = _left_out(pieces, rows)
    relations = relations_of(drivable.ways)
    turns = np.array([turn_of(way) for way in drivable.ways], dtype=np.int64)
    ring = ring_pieces(list(dict.fromkeys(rows.pieces)))
    yields = yielding_ways(content, drivable.ways, relations, ring)
    junctions, junction_of = number_junctions(content, drivable.ways, ring, yields)
    signals, signal = signals_of(content, drivable.ways, junction_of, relations.conflicts)
    graph = build_graph(drivable, rows, junction_of, turns)
    network, indices = build_network(drivable, rows, graph)
    _report(content.name, drivable, left_out)
    return Town(
        name=name,
        network=network,
        graph=graph,
        movements=build_movements(
            drivable, rows, relations, yields, priorities(drivable.ways, turns, yields), signal
        ),
        signals=signals,
        lane_indices=indices,
        road_name=tuple(piece.strip.road.name for piece in rows.pieces),
        lane_id=np.array([piece.lane.id for piece in rows.pieces], dtype=np.int64),
        junctions=junctions,
        lane_kilometres=roadway.lane_kilometres,
        junction_arms=roadway.junction_arms,
        left_out=left_out,
    )


def _check_drivable(name: str, drivable: Drivable) -> None:
    if not any(piece.successors for piece in drivable.pieces):
        raise MapError(f"{name}: its driving lanes do not lead to each other: nobody could drive for long")


def _left_out(pieces: list, rows: Rows) -> tuple[tuple[str, int, float], ...]:
    kept = set(rows.pieces)
    lost: dict[tuple[str, int], float] = defaultdict(float)
    for piece in pieces:
        if piece not in kept:
            lost[piece.strip.road.name, piece.lane.id] += piece.length
    return tuple((road, lane, length) for (road, lane), length in lost.items())


def _report(name: str, drivable: Drivable, left_out: tuple[tuple[str, int, float], ...]) -> None:
    for road, lane, length in left_out:
        _log.debug("%s: %s, lane %d: %.1f m left out", name, road, lane, length)
    if left_out:
        _log.info(
            "%s: %.1f m of %d lanes left out, as they lead nowhere or nothing leads there: %s",
            name,
            sum(length for *_, length in left_out),
            len(left_out),
            _names(sorted({road for road, *_ in left_out})),
        )
    if drivable.opened:
        _log.info("%s: %d changes of lane allowed against the marks", name, drivable.opened)


def _names(roads: list[str]) -> str:
    """The roads' names, the first few of many."""
    more = f" and {len(roads) - _ROADS_NAMED} more" if len(roads) > _ROADS_NAMED else ""
    return ", ".join(roads[:_ROADS_NAMED]) + more
