"""CARLA's maps are read whole: the totals are those that were measured on them."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from athrl_driving.maps import Town


@pytest.mark.parametrize(
    ("name", "kilometres", "arms"),
    [
        ("Town02", 2.85, {3: 8}),
        ("Town03", 13.24, {3: 22, 4: 10, 5: 1, 2: 1}),
        ("Town04", 33.15, {3: 14, 4: 13}),
    ],
)
def test_totals_are_those_measured(
    load_any: Callable[[str], Town], name: str, kilometres: float, arms: dict[int, int]
) -> None:
    town = load_any(f"{name}.xodr")
    assert town.lane_kilometres == pytest.approx(kilometres, rel=0.01)
    assert town.junction_arms == Counter(arms)


@pytest.mark.parametrize(("name", "left_out"), [("Town02", 0.0), ("Town03", 21.0), ("Town04", 0.0)])
def test_almost_nothing_is_left_out(load_any: Callable[[str], Town], name: str, left_out: float) -> None:
    town = load_any(f"{name}.xodr")
    assert sum(length for _, _, length in town.left_out) <= left_out
    distinct = dict(zip(town.lane_indices, town.graph.length.tolist(), strict=True))
    driven = sum(distinct.values()) + sum(length for _, _, length in town.left_out)
    assert driven / 1000.0 == pytest.approx(town.lane_kilometres, rel=0.01)


def lanes_near(town: Town, x: float, y: float, reach: float) -> np.ndarray:
    centre = 0.5 * (town.graph.box[:, :2] + town.graph.box[:, 2:])
    return np.flatnonzero(np.hypot(centre[:, 0] - x, centre[:, 1] - y) < reach)


def test_the_roundabout_of_town03_turns_left_and_its_entries_yield(load_any: Callable[[str], Town]) -> None:
    town = load_any("Town03.xodr")
    graph, movements = town.graph, town.movements
    (ring,) = (number for number, junction in enumerate(town.junctions) if junction.kind == "roundabout")
    own = np.array([graph.junction[movements.lane[start]] == ring for start in movements.lane_start[:-1]])
    assert movements.yields[own].sum() >= 4
    near = lanes_near(town, 0.0, 0.5, 25.0)
    lanes = near[(graph.movement[near] >= 0) & (np.abs(graph.curvature[near]) > 1.0 / 24.0)]
    assert (graph.curvature[lanes] < 0.0).mean() > 0.6


def test_the_overpass_of_town04_is_no_crossing(load_any: Callable[[str], Town]) -> None:
    """Near (5, 20) one road passes above another; no movement of one is in the way of the other's."""
    town = load_any("Town04.xodr")
    graph, movements = town.graph, town.movements
    near = lanes_near(town, 5.0, 20.0, 60.0)
    heights = graph.elevation[near]
    assert heights.max() - heights.min() > 5.0
    first = np.repeat(np.arange(len(movements.length)), np.diff(movements.conflict_start))
    for a, b in zip(first.tolist(), movements.conflict.tolist(), strict=True):
        lanes_a = movements.lane[movements.lane_start[a] : movements.lane_start[a + 1]]
        lanes_b = movements.lane[movements.lane_start[b] : movements.lane_start[b + 1]]
        apart = np.abs(graph.elevation[lanes_a][:, None] - graph.elevation[lanes_b][None])
        assert apart.min() < 3.0


def test_the_highway_of_town04_has_lanes_to_change_to(load_any: Callable[[str], Town]) -> None:
    graph = load_any("Town04.xodr").graph
    beside = (graph.left >= 0) | (graph.right >= 0)
    assert graph.length[beside].sum() > 20_000.0
