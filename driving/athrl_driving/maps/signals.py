"""Traffic lights: which movements they govern, and when they are green.

OpenDRIVE says where lights stand, for which lanes they hold and which of them one controller switches
together, but not when: the phases are a fixed cycle set here. One group of each junction is green at a time,
and with it those that it does not conflict with.
"""

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from athrl_driving.maps.disjoint_sets import DisjointSets
from athrl_driving.maps.governing_lights import governing_lights
from athrl_driving.maps.lane_graph import Signals
from athrl_driving.maps.light_groups import group_lights
from athrl_driving.maps.opendrive.model import OpenDrive
from athrl_driving.maps.standing_segments import Movement

GREEN = 15.0
YELLOW = 3.0
ALL_RED = 2.0
"""Seconds of a group's phases."""


def signals_of(
    content: OpenDrive, movements: list[Movement], junction: NDArray[np.int64], conflicts: NDArray[np.int64]
) -> tuple[Signals, NDArray[np.int64]]:
    """Return the groups of lights, and for every movement [M] the group that governs it or -1.

    `junction` is the number of each movement's junction [M], `conflicts` are the ordered pairs of conflicting
    movements [C, 2].
    """
    lights = governing_lights(content, movements)
    group_of = group_lights(content, movements, lights, junction, conflicts)
    return _phases(_junctions_of_groups(group_of, junction), _conflicting(group_of, conflicts)), group_of


def _junctions_of_groups(group_of: NDArray[np.int64], junction: NDArray[np.int64]) -> list[int]:
    """Return the number of each group's junction."""
    return [int(junction[group_of == group][0]) for group in range(int(group_of.max(initial=-1)) + 1)]


def _conflicting(group_of: NDArray[np.int64], conflicts: NDArray[np.int64]) -> dict[int, set[int]]:
    """Return the groups that each group must not be green with."""
    pairs = group_of[conflicts]
    pairs = pairs[(pairs >= 0).all(axis=1) & (pairs[:, 0] != pairs[:, 1])]
    result: dict[int, set[int]] = defaultdict(set)
    for first, second in np.unique(pairs, axis=0).tolist():
        result[first].add(second)
    return result


def _phases(junctions: list[int], conflicting: dict[int, set[int]]) -> Signals:
    """Give every group a phase in its junction's cycle; groups without a conflict share one."""
    signals = Signals(*(np.zeros(len(junctions)) for _ in Signals._fields))
    for groups in _switched_together(junctions, conflicting):
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


def _switched_together(junctions: list[int], conflicting: dict[int, set[int]]) -> list[list[int]]:
    """Return the groups by junction; junctions whose movements conflict share a cycle."""
    joined = DisjointSets(junctions)
    for group, others in conflicting.items():
        for other in others:
            joined.join(junctions[group], junctions[other])
    result: dict[int, list[int]] = defaultdict(list)
    for group, junction in enumerate(junctions):
        result[joined.root(junction)].append(group)
    return list(result.values())
