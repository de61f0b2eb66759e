"""Traffic lights: which ways they govern, and when they are green.

OpenDRIVE says where lights stand, for which lanes they hold and which of them one controller switches
together, but not when: the phases are a fixed cycle of ours. One group of each junction is green at a time.
"""

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.lane_graph import Signals, no_signals
from athrl_driving.maps.opendrive.model import OpenDrive, Road, Signal
from athrl_driving.maps.opendrive.strips import LanePiece
from athrl_driving.maps.stretches import Way

GREEN = 15.0
YELLOW = 3.0
ALL_RED = 2.0
"""Seconds of a group's phases."""


def signals_of(
    content: OpenDrive, ways: list[Way], cluster: NDArray[np.int64], conflicts: NDArray[np.int64]
) -> tuple[Signals, NDArray[np.int64]]:
    """Return the groups of lights, and for every way [M] the group that governs it or -1.

    `cluster` is the junction of each way [M], `conflicts` the ordered pairs of ways in conflict [C, 2].
    """
    group_of = np.full(len(ways), -1, dtype=np.int64)
    controller = {signal: name for name, signals in content.controllers.items() for signal in signals}
    lights = [(road, signal) for road in content.roads.values() for signal in road.signals]
    if not lights:
        return no_signals(), group_of
    keys: dict[tuple[int, str], int] = {}
    for place, way in enumerate(ways):
        for road, signal in lights:
            if _governs(road, signal, way):
                name = controller.get(signal.id) or f"{road.id}:{signal.orientation}"
                group_of[place] = keys.setdefault((int(cluster[place]), name), len(keys))
                break
    return _phases(keys, _conflicting(group_of, conflicts)), group_of


def _governs(road: Road, signal: Signal, way: Way) -> bool:
    """Tell whether a light holds for a way: it stands at the road that the way comes from, or on the way."""
    return any(
        piece.strip.road is road and _holds_for(signal, piece, at_end)
        for piece, at_end in ((way.origin, True), *((piece, False) for piece in way.pieces))
    )


def _holds_for(signal: Signal, piece: LanePiece, at_end: bool) -> bool:
    forward = piece.strip.forward
    if (signal.orientation == "+" and not forward) or (signal.orientation == "-" and forward):
        return False
    lane = piece.keys[-1][1]
    if signal.lanes and not any(low <= lane <= high for low, high in signal.lanes):
        return False
    # Beside an ordinary road a light belongs to the junction at the end that it is nearest to.
    middle = 0.5 * piece.strip.road.length
    return not at_end or (signal.s >= middle) == forward


def _conflicting(group_of: NDArray[np.int64], conflicts: NDArray[np.int64]) -> dict[int, set[int]]:
    result: dict[int, set[int]] = defaultdict(set)
    for first, second in group_of[conflicts].tolist():
        if first >= 0 and second >= 0 and first != second:
            result[first].add(second)
    return result


def _phases(keys: dict[tuple[int, str], int], conflicting: dict[int, set[int]]) -> Signals:
    """Give every group of a junction a phase; groups without a conflict share one."""
    signals = Signals(*(np.zeros(len(keys)) for _ in Signals._fields))
    by_cluster: dict[int, list[int]] = defaultdict(list)
    for (cluster, _), group in keys.items():
        by_cluster[cluster].append(group)
    for groups in by_cluster.values():
        phase: dict[int, int] = {}
        for group in groups:
            taken = {phase[other] for other in conflicting[group] if other in phase}
            phase[group] = next(number for number in range(len(groups)) if number not in taken)
        phases = max(phase.values()) + 1
        for group in groups:
            start = phase[group] * (GREEN + YELLOW + ALL_RED)
            signals.cycle[group] = phases * (GREEN + YELLOW + ALL_RED)
            signals.green_from[group], signals.green_until[group] = start, start + GREEN
            signals.yellow[group] = YELLOW
    return signals
