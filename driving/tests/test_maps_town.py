"""What every town promises to those who drive in it: the project's own and CARLA's."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from athrl_driving.maps import TOWNS, Town, lane_pose, load_town


@pytest.fixture(scope="module", params=[*TOWNS, "Town02.xodr", "Town03.xodr", "Town04.xodr"])
def town(request: pytest.FixtureRequest, load_any: Callable[[str], Town]) -> Town:
    return load_any(request.param)


def successors(town: Town, row: int) -> np.ndarray:
    graph = town.graph
    return graph.successor[graph.successor_start[row] : graph.successor_start[row + 1]]


def rows_of(town: Town, movement: int) -> list[int]:
    movements = town.movements
    return movements.lane[movements.lane_start[movement] : movements.lane_start[movement + 1]].tolist()


def pairs(start: np.ndarray, values: np.ndarray) -> list[tuple[int, int]]:
    first = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return list(zip(first.tolist(), values.tolist(), strict=True))


def test_every_lane_link_closes(town: Town) -> None:
    for row in range(len(town.graph.length)):
        x, y, heading = lane_pose(town.graph, row, town.graph.length[row])
        for following in successors(town, row):
            next_x, next_y, next_heading = lane_pose(town.graph, following, 0.0)
            assert math.hypot(next_x - x, next_y - y) < 0.01
            assert abs((next_heading - heading + math.pi) % (2 * math.pi) - math.pi) < 0.02


def test_heights_have_no_steps(town: Town) -> None:
    graph = town.graph
    for row in range(len(graph.length)):
        end = graph.elevation[row] + graph.grade[row] * graph.length[row]
        for following in successors(town, row):
            assert graph.elevation[following] == pytest.approx(end, abs=0.1)


def test_every_lane_can_be_reached_from_every_other(town: Town) -> None:
    graph = town.graph
    edges: list[set[int]] = [set(successors(town, row).tolist()) for row in range(len(graph.length))]
    for beside in (graph.left, graph.right):
        for row in np.flatnonzero(beside >= 0).tolist():
            edges[row].add(int(beside[row]))
    backwards: list[set[int]] = [set() for _ in edges]
    for row, targets in enumerate(edges):
        for target in targets:
            backwards[target].add(row)
    for links in (edges, backwards):
        reached, waiting = {0}, [0]
        while waiting:
            fresh = links[waiting.pop()] - reached
            reached |= fresh
            waiting += fresh
        assert len(reached) == len(graph.length)


def test_only_dead_ends_have_no_successor(town: Town) -> None:
    graph = town.graph
    ends = np.diff(graph.successor_start) == 0
    np.testing.assert_array_equal(graph.dead_end, ends)
    beside = (graph.left >= 0) | (graph.right >= 0)
    assert beside[graph.dead_end].all()


def test_neighbours_lie_beside_each_other(town: Town) -> None:
    graph = town.graph
    for beside, back, side in ((graph.left, graph.right, -1.0), (graph.right, graph.left, 1.0)):
        for row in np.flatnonzero(beside >= 0).tolist():
            other = int(beside[row])
            assert back[other] in (row, -1)
            assert graph.movement[row] == graph.movement[other] == -1
            for share in (0.0, 0.5, 1.0):
                x, y, heading = lane_pose(town.graph, row, share * graph.length[row])
                other_x, other_y, _ = lane_pose(town.graph, other, share * graph.length[other])
                across = (other_y - y) * math.cos(heading) - (other_x - x) * math.sin(heading)
                along = (other_x - x) * math.cos(heading) + (other_y - y) * math.sin(heading)
                assert 2.0 < side * across < 5.0
                assert abs(along) < 0.1


def test_a_movement_leads_from_a_lane_to_the_next(town: Town) -> None:
    graph, movements = town.graph, town.movements
    for movement in range(len(movements.length)):
        chain = [movements.origin[movement], *rows_of(town, movement), movements.exit[movement]]
        for row, following in itertools.pairwise(chain):
            assert following in successors(town, row)
        rows = chain[1:-1]
        assert set(graph.movement[rows]) == {movement}
        assert graph.movement[chain[0]] == graph.movement[chain[-1]] == -1
        assert len(set(graph.junction[rows])) == 1
        np.testing.assert_allclose(
            graph.movement_offset[rows], np.concatenate([[0.0], np.cumsum(graph.length[rows])[:-1]])
        )
        assert movements.length[movement] == pytest.approx(graph.length[rows].sum())
    assert (graph.junction[graph.movement < 0] == -1).all()


def test_behind_every_movement_there_is_room_to_stand(town: Town) -> None:
    graph, movements = town.graph, town.movements
    for row in set(movements.exit.tolist()):
        room = 0.0
        while room < 12.0 and graph.movement[row] < 0:
            room += graph.length[row]
            if graph.dead_end[row] or len(successors(town, row)) > 1:
                break
            row = int(successors(town, row)[0])
        assert room >= 12.0


def test_conflicts_are_mutual_and_merging_is_one(town: Town) -> None:
    movements = town.movements
    conflicts = set(pairs(movements.conflict_start, movements.conflict))
    siblings = set(pairs(movements.sibling_start, movements.sibling))
    assert all((other, movement) in conflicts for movement, other in conflicts)
    for a in range(len(movements.length)):
        for b in range(len(movements.length)):
            same_origin = movements.origin[a] == movements.origin[b]
            assert ((a, b) in siblings) == (a != b and same_origin)
            if a != b and not same_origin and movements.exit[a] == movements.exit[b]:
                assert (a, b) in conflicts
            assert not (same_origin and (a, b) in conflicts)
    lengths = movements.length[movements.conflict]
    assert (movements.release > 0.0).all()
    assert (movements.release <= lengths + 1e-9).all()


def test_vehicles_beyond_the_release_are_out_of_the_way(town: Town) -> None:
    movements = town.movements
    points = [
        np.array(
            [
                (*lane_pose(town.graph, row, s)[:2], town.graph.movement_offset[row] + s)
                for row in rows_of(town, movement)
                for s in np.linspace(0.0, town.graph.length[row], 1 + math.ceil(town.graph.length[row]))
            ]
        )
        for movement in range(len(movements.length))
    ]
    found = pairs(movements.conflict_start, movements.conflict)
    for (movement, other), release in zip(found, movements.release, strict=True):
        beyond = points[other][points[other][:, 2] > release + 1e-6]
        if len(beyond):
            apart = np.linalg.norm(points[movement][:, None, :2] - beyond[None, :, :2], axis=2)
            assert apart.min() > 2.4


def test_who_gives_way_comes_last(town: Town) -> None:
    movements = town.movements
    assert movements.priority.min() == 0
    if movements.yields.any():
        assert movements.priority[movements.yields].min() > movements.priority[~movements.yields].max()
    first = {int(movements.conflict_start[row]) for row in np.flatnonzero(movements.yields)}
    assert len(first) <= len(movements.length)


def test_lanes_are_named_as_in_the_file(town: Town) -> None:
    assert len(town.road_name) == len(town.lane_id) == len(town.lane_indices) == len(town.graph.length)
    assert (town.lane_id != 0).all()


def test_an_unknown_town_is_refused_with_those_there_are() -> None:
    with pytest.raises(
        ValueError, match=r"no town named 'town99', did you mean 'town0\d'\? There are .*town03.*xodr"
    ):
        load_town("town99")


def test_a_town_is_read_once() -> None:
    assert load_town("town03") is load_town("town03")
