"""What a town promises to those who drive in it."""

import math

import numpy as np
import pytest
from athrl_driving.maps import (
    Node,
    Street,
    Town,
    TownDescription,
    build_town,
    lane_pose,
    lane_project,
    load_town,
)


@pytest.fixture(scope="module")
def town() -> Town:
    return load_town("town03")


def successors(town: Town, row: int) -> np.ndarray:
    graph = town.graph
    return graph.successor[graph.successor_start[row] : graph.successor_start[row + 1]]


def test_every_lane_link_closes(town: Town) -> None:
    for row in range(len(town.graph.length)):
        x, y, heading = lane_pose(town.graph, row, town.graph.length[row])
        assert len(successors(town, row)) > 0
        for following in successors(town, row):
            next_x, next_y, next_heading = lane_pose(town.graph, following, 0.0)
            assert math.hypot(next_x - x, next_y - y) < 1e-3
            assert abs((next_heading - heading + math.pi) % (2 * math.pi) - math.pi) < 1e-6


def test_every_lane_can_be_reached_from_every_other(town: Town) -> None:
    count = len(town.graph.length)
    reached = np.eye(count, dtype=np.float32)
    for row in range(count):
        reached[row, successors(town, row)] = 1.0
    for _ in range(math.ceil(math.log2(count))):
        reached = np.minimum(reached @ reached, 1.0)
    assert (reached > 0.0).all()


def test_the_town_has_all_kinds_of_junctions(town: Town) -> None:
    kinds = [junction.kind for junction in town.junctions]
    assert kinds.count("T-junction") >= 4
    assert kinds.count("crossing") >= 1
    assert kinds.count("roundabout") >= 3
    assert set(np.unique(town.graph.junction)) == set(range(-1, len(kinds)))


def test_the_town_has_room_for_its_traffic(town: Town) -> None:
    assert 10.0 <= town.graph.length.sum() / 1000.0 <= 14.0
    beside = (town.graph.right >= 0) & (town.graph.junction < 0)
    assert town.graph.length[beside].sum() > 500.0


def test_a_car_can_drive_every_turn(town: Town) -> None:
    tightest = 1.0 / np.abs(town.graph.curvature).max()
    # A car of 4.9 m that steers 21 degrees turns on a circle of about 6.8 m.
    assert tightest >= 7.0


def test_traffic_keeps_to_the_right(town: Town) -> None:
    streets = {index[:2]: row for row, index in enumerate(town.lane_indices) if ">" in index[0]}
    pairs = 0
    for (start, _), row in streets.items():
        name, piece = start.split(":")
        origin, destination = name.split(">")
        if piece != "0":
            continue
        ends = [node for node in streets if node[1].startswith(f"{destination}>{origin}:")]
        oncoming = streets[max(ends, key=lambda node: int(node[1].split(":")[1]))]
        x, y, _ = lane_pose(town.graph, oncoming, town.graph.length[oncoming])
        _, lateral = lane_project(town.graph, row, x, y)
        assert lateral < -3.0
        pairs += 1
    assert pairs == 36


def test_turns_are_named_from_the_drivers_seat(town: Town) -> None:
    graph, movements = town.graph, town.movements
    for movement in range(len(movements.length)):
        rows = movements.lane[movements.lane_start[movement] : movements.lane_start[movement + 1]]
        if town.junctions[graph.junction[rows[0]]].kind == "roundabout":
            continue
        turned = float((graph.curvature[rows] * graph.length[rows]).sum())
        expected = 1 if abs(turned) < 0.6 else (2 if turned > 0.0 else 0)
        assert set(graph.turn[rows]) == {expected}


def test_the_roundabout_turns_left_and_its_entries_yield(town: Town) -> None:
    graph, movements = town.graph, town.movements
    entries = np.flatnonzero(movements.yields)
    assert len(entries) == 4
    for entry in entries:
        assert graph.curvature[movements.exit[entry]] == pytest.approx(-1.0 / 26.0)
        assert graph.curvature[movements.origin[entry]] == 0.0


def test_conflicts_are_mutual_and_merging_is_one(town: Town) -> None:
    movements = town.movements
    pairs = {
        (movement, int(other))
        for movement in range(len(movements.length))
        for other in movements.conflict[
            movements.conflict_start[movement] : movements.conflict_start[movement + 1]
        ]
    }
    assert all((other, movement) in pairs for movement, other in pairs)
    assert all(movements.origin[a] != movements.origin[b] for a, b in pairs)
    for a in range(len(movements.length)):
        for b in range(len(movements.length)):
            if (
                a != b
                and movements.exit[a] == movements.exit[b]
                and movements.origin[a] != movements.origin[b]
            ):
                assert (a, b) in pairs


def test_an_unknown_town_is_refused_with_those_there_are() -> None:
    with pytest.raises(ValueError, match="no town named 'town99'; choose one of: town03"):
        load_town("town99")


@pytest.mark.parametrize(
    ("streets", "message"),
    [
        ((Street("a", "x"),), "street a - x: there is no node named x"),
        ((Street("a", "b"), Street("a", "c")), "node a: 2 streets meet there"),
        ((Street("a", "d"),), "street a - d: it must start straight"),
    ],
)
def test_a_description_that_cannot_be_built_names_the_place(
    streets: tuple[Street, ...], message: str
) -> None:
    nodes = (Node("a", 0.0, 0.0), Node("b", 100.0, 0.0), Node("c", 0.0, 100.0), Node("d", 20.0, 0.0))
    with pytest.raises(ValueError, match=message):
        build_town(TownDescription("broken", nodes, streets))
