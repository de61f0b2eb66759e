"""What every town guarantees to vehicles: the project's own towns and CARLA's."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from athrl_driving.maps import TOWNS, Town, lane_pose, load_town


@pytest.fixture(scope="module", params=[*TOWNS, "random-7", "Town02.xodr", "Town03.xodr", "Town04.xodr"])
def town(request: pytest.FixtureRequest, load_any: Callable[[str], Town]) -> Town:
    return load_any(request.param)


def successors(town: Town, lane: int) -> np.ndarray:
    graph = town.graph
    return graph.successor[graph.successor_start[lane] : graph.successor_start[lane + 1]]


def lanes_of(town: Town, movement: int) -> list[int]:
    movements = town.movements
    return movements.lane[movements.lane_start[movement] : movements.lane_start[movement + 1]].tolist()


def pairs(start: np.ndarray, values: np.ndarray) -> list[tuple[int, int]]:
    first = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return list(zip(first.tolist(), values.tolist(), strict=True))


def test_every_lane_link_closes(town: Town) -> None:
    for lane in range(len(town.graph.length)):
        x, y, heading = lane_pose(town.graph, lane, town.graph.length[lane])
        for following in successors(town, lane):
            next_x, next_y, next_heading = lane_pose(town.graph, following, 0.0)
            assert math.hypot(next_x - x, next_y - y) < 0.01
            assert abs((next_heading - heading + math.pi) % (2 * math.pi) - math.pi) < 0.02


def test_heights_have_no_steps(town: Town) -> None:
    graph = town.graph
    for lane in range(len(graph.length)):
        end = graph.elevation[lane] + graph.grade[lane] * graph.length[lane]
        for following in successors(town, lane):
            assert graph.elevation[following] == pytest.approx(end, abs=0.1)


def test_every_lane_can_be_reached_from_every_other(town: Town) -> None:
    graph = town.graph
    edges: list[set[int]] = [set(successors(town, lane).tolist()) for lane in range(len(graph.length))]
    for beside in (graph.left, graph.right):
        for lane in np.flatnonzero(beside >= 0).tolist():
            edges[lane].add(int(beside[lane]))
    backwards: list[set[int]] = [set() for _ in edges]
    for lane, targets in enumerate(edges):
        for target in targets:
            backwards[target].add(lane)
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
        for lane in np.flatnonzero(beside >= 0).tolist():
            other = int(beside[lane])
            assert back[other] in (lane, -1)
            assert graph.movement[lane] == graph.movement[other] == -1
            for share in (0.0, 0.5, 1.0):
                x, y, heading = lane_pose(town.graph, lane, share * graph.length[lane])
                other_x, other_y, _ = lane_pose(town.graph, other, share * graph.length[other])
                across = (other_y - y) * math.cos(heading) - (other_x - x) * math.sin(heading)
                along = (other_x - x) * math.cos(heading) + (other_y - y) * math.sin(heading)
                assert 2.0 < side * across < 5.0
                assert abs(along) < 0.1


def test_a_movement_leads_from_a_lane_to_the_next(town: Town) -> None:
    graph, movements = town.graph, town.movements
    for movement in range(len(movements.length)):
        chain = [movements.origin[movement], *lanes_of(town, movement), movements.exit[movement]]
        for lane, following in itertools.pairwise(chain):
            assert following in successors(town, lane)
        lanes = chain[1:-1]
        assert set(graph.movement[lanes]) == {movement}
        assert graph.movement[chain[0]] == graph.movement[chain[-1]] == -1
        assert len(set(graph.junction[lanes])) == 1
        np.testing.assert_allclose(
            graph.movement_offset[lanes], np.concatenate([[0.0], np.cumsum(graph.length[lanes])[:-1]])
        )
        assert movements.length[movement] == pytest.approx(graph.length[lanes].sum())
    assert (graph.junction[graph.movement < 0] == -1).all()


def test_behind_every_movement_there_is_room_to_stand(town: Town) -> None:
    graph, movements = town.graph, town.movements
    for lane in set(movements.exit.tolist()):
        room = 0.0
        while room < 12.0 and graph.movement[lane] < 0:
            room += graph.length[lane]
            if graph.dead_end[lane] or len(successors(town, lane)) > 1:
                break
            lane = int(successors(town, lane)[0])
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
                (*lane_pose(town.graph, lane, s)[:2], town.graph.movement_offset[lane] + s)
                for lane in lanes_of(town, movement)
                for s in np.linspace(0.0, town.graph.length[lane], 1 + math.ceil(town.graph.length[lane]))
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


def test_movements_that_yield_come_last(town: Town) -> None:
    movements = town.movements
    assert movements.priority.min() == 0
    if movements.yields.any():
        assert movements.priority[movements.yields].min() > movements.priority[~movements.yields].max()
    first = {int(movements.conflict_start[movement]) for movement in np.flatnonzero(movements.yields)}
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
