"""Routes from search: they are the shortest, they change lanes smoothly, they arrive."""

import itertools

import networkx
import numpy as np
import pytest
from athrl_driving.maps import TOWNS, lane_pose, lane_project, load_town
from athrl_driving.maps.lane_graph import LaneGraph
from athrl_driving.route import Route, dead_end_distance, new_routes, plan_length, shortest_route
from athrl_driving.route import start_routes as start
from athrl_driving.route.search import LEAST_ROOM, change_cost
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

GRAPHS = {name: load_town(name).graph for name in sorted(TOWNS)}
NO_PLAN = np.empty(0, np.int64)
SEEDS = st.integers(0, 2**32 - 1)


def weighted(graph: LaneGraph, origin: int) -> networkx.DiGraph:
    """The same lanes and costs for networkx; from a short first lane no change is possible."""
    digraph = networkx.DiGraph()
    digraph.add_nodes_from(range(graph.length.size))
    for lane in range(graph.length.size):
        following = graph.successor[graph.successor_start[lane] : graph.successor_start[lane + 1]]
        steps = [(int(other), float(graph.length[lane])) for other in following]
        change = float(change_cost.py_func(graph, lane, 0.0))
        if lane != origin or graph.length[lane] >= LEAST_ROOM:
            steps += [(int(other), change) for other in (graph.left[lane], graph.right[lane]) if other >= 0]
        # Of two steps to the same lane the costlier is added first, and replaced.
        for other, weight in sorted(steps, key=lambda step: -step[1]):
            digraph.add_edge(lane, other, weight=weight)
    return digraph


def cost(digraph: networkx.DiGraph, plan: NDArray[np.int64]) -> float:
    return sum(
        digraph.edges[a, b]["weight"] for a, b in zip(plan[:-1].tolist(), plan[1:].tolist(), strict=True)
    )


def random_graph(seed: int) -> LaneGraph:
    """Rows of random lengths with random successors and neighbours; only the search makes sense on it."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 30))
    starts = np.concatenate([[0], np.cumsum(rng.integers(0, 4, count))])
    neighbours = [np.where(rng.random(count) < 0.3, rng.integers(0, count, count), -1) for _ in range(2)]
    return GRAPHS["town03"]._replace(
        length=rng.uniform(1.0, 100.0, count),
        successor_start=starts,
        successor=rng.integers(0, count, starts[-1]),
        left=neighbours[0],
        right=neighbours[1],
    )


@settings(max_examples=100, deadline=None)
@given(SEEDS)
def test_shortest_route_is_as_short_as_networkx_finds(seed: int) -> None:
    graph = random_graph(seed)
    origin, destination = np.random.default_rng(seed).integers(0, graph.length.size, 2).tolist()
    digraph = weighted(graph, origin)
    if not networkx.has_path(digraph, origin, destination):
        with pytest.raises(ValueError, match=f"no way leads from lane {origin} to lane {destination}"):
            shortest_route(graph, origin, destination)
        return
    plan = shortest_route(graph, origin, destination)
    assert (plan[0], plan[-1]) == (origin, destination)
    best = networkx.shortest_path_length(digraph, origin, destination, weight="weight")
    assert cost(digraph, plan) == pytest.approx(best)


@pytest.mark.parametrize("name", sorted(GRAPHS))
def test_shortest_routes_in_towns_are_the_shortest(name: str) -> None:
    graph = GRAPHS[name]
    rng = np.random.default_rng(0)
    for origin in rng.integers(0, graph.length.size, 5).tolist():
        digraph = weighted(graph, origin)
        best = networkx.single_source_dijkstra_path_length(digraph, origin)
        for destination in rng.integers(0, graph.length.size, 10).tolist():
            assert cost(digraph, shortest_route(graph, origin, destination)) == pytest.approx(
                best[destination]
            )


def test_route_around_leaves_the_lane_and_comes_back() -> None:
    graph = GRAPHS["town03"]
    assert shortest_route(graph, 5, 5).tolist() == [5]
    around = shortest_route(graph, 5, 5, around=True)
    assert (around[0], around[-1]) == (5, 5)
    assert around.size > 2
    digraph = weighted(graph, 5)
    loops = (
        digraph.edges[5, following]["weight"]
        + networkx.shortest_path_length(digraph, following, 5, weight="weight")
        for following in digraph.successors(5)
    )
    assert cost(digraph, around) == pytest.approx(min(loops))


def test_destination_behind_on_the_lane_beside_is_reached_by_driving_around() -> None:
    graph = GRAPHS["town03"]
    lane = int(np.flatnonzero((graph.right >= 0) & (graph.length > 100.0))[0])
    beside = int(graph.right[lane])
    ahead = shortest_route(graph, lane, beside, start=40.0, goal=90.0)
    assert ahead.tolist() == [lane, beside]
    behind = shortest_route(graph, lane, beside, start=70.0, goal=20.0)
    assert behind.size > 2
    assert plan_length(graph, behind, 70.0, 20.0) > float(graph.length[lane])
    # Not by a change to the lane beside and back either.
    around = shortest_route(graph, lane, lane, start=70.0, goal=20.0, around=True)
    assert plan_length(graph, around, 70.0, 20.0) > float(graph.length[lane])


def test_no_lane_is_changed_where_too_little_of_the_first_is_left() -> None:
    graph = GRAPHS["town03"]
    for lane in np.flatnonzero((graph.right >= 0) & (graph.length > 40.0))[:20].tolist():
        start = float(graph.length[lane]) - 10.0
        for destination in range(0, graph.length.size, 60):
            try:
                plan = shortest_route(graph, lane, destination, start=start, goal=1.0)
            except ValueError:
                continue
            if plan.size > 1:
                assert plan[1] not in (graph.left[lane], graph.right[lane])
                route = Route.planned(graph, plan, start, 1.0)
                assert route.routes.plan_count[0] > 0 or np.isfinite(route.arrival)  # it is not given up


def test_lanes_that_do_not_exist_are_refused() -> None:
    with pytest.raises(ValueError, match=r"the destination is lane 99999, it should be a lane from 0 to"):
        shortest_route(GRAPHS["town03"], 0, 99999)


def largest_break(route: Route) -> float:
    """The largest gap (m) and kink (rad) between the segments that are known."""
    segments, ends = route.segments, route.starts[1:-1]
    before = np.array([_end(segment) for segment in segments[:-1]])
    gaps = np.hypot(before[:, 0] - segments[1:, 0], before[:, 1] - segments[1:, 1])
    kinks = np.abs((before[:, 2] - segments[1:, 2] + np.pi) % (2 * np.pi) - np.pi)
    assert ends == pytest.approx(segments[1:, 5])
    return float(max(gaps.max(initial=0.0), kinks.max(initial=0.0)))


def _end(segment: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, heading, curvature, length, _ = segment
    if curvature == 0.0:
        return x + length * np.cos(heading), y + length * np.sin(heading), heading
    end = heading + curvature * length
    return (
        x + (np.sin(end) - np.sin(heading)) / curvature,
        y - (np.cos(end) - np.cos(heading)) / curvature,
        end,
    )


def changes(graph: LaneGraph, plan: NDArray[np.int64]) -> int:
    return sum(b in (graph.left[a], graph.right[a]) for a, b in itertools.pairwise(plan))


@pytest.mark.parametrize("name", sorted(GRAPHS))
def test_planned_routes_are_smooth_and_arrive(name: str) -> None:
    graph = GRAPHS[name]
    rng = np.random.default_rng(1)
    ordinary = np.flatnonzero(graph.movement < 0)
    ends = [rng.choice(ordinary, 2) for _ in range(12)]
    wide = np.flatnonzero((graph.right >= 0) & (graph.length > 40.0))
    beside = rng.choice(wide, min(wide.size, 6), replace=False)
    # Routes that have to change lanes: to the lane beside the one that follows.
    ends += [np.array([lane, graph.right[lane]]) for lane in beside]
    changed = 0
    for origin, destination in ends:
        plan = shortest_route(graph, int(origin), int(destination))
        changed += changes(graph, plan)
        goal = 0.5 * float(graph.length[destination])
        route = Route.planned(graph, plan, 0.0, goal)
        for _ in range(2000):
            assert largest_break(route) < 1e-3
            if route.position >= route.arrival - 1e-6:
                break
            x, y, _ = route.poses(np.array([min(route.position + 5.0, route.arrival)]))[0]
            before = route.position
            route.advance(x, y)
            assert before < route.position
        assert route.lane == destination
        # An S is a little longer than the lanes along it, and may have no room before the destination.
        assert (
            -1e-6 <= route.arrival - plan_length(graph, plan, 0.0, goal) < 1.0 + 15.0 * changes(graph, plan)
        )
        x, y, _ = route.poses(np.array([route.arrival]))[0]
        s, lateral = lane_project(graph, int(destination), x, y)
        assert abs(lateral) < 4.0
        assert s >= goal - 0.1
    assert changed > 0 or not beside.size


def test_lane_change_leads_from_the_middle_of_one_lane_to_that_of_the_other() -> None:
    graph = GRAPHS["town03"]
    lanes = np.flatnonzero((graph.right >= 0) & (graph.length > 60.0))
    assert lanes.size > 0
    for lane in lanes:
        beside = int(graph.right[lane])
        plan = np.array([lane, beside])
        route = Route.planned(graph, plan, 3.0, 55.0)
        across = []
        for position in np.arange(0.0, 50.0, 0.5):
            x, y, heading = route.poses(np.array([position]))[0]
            s, lateral = lane_project(graph, int(lane), x, y)
            across.append(lateral)
            assert np.cos(heading - lane_pose(graph, int(lane), s)[2]) > np.cos(0.3)
        assert across[0] == pytest.approx(0.0, abs=1e-6)
        width = 0.5 * (graph.width[lane] + graph.width[beside])
        assert across[-1] == pytest.approx(width, abs=0.1)
        assert np.all(np.diff(across) > -1e-6)
        steps = np.linalg.norm(np.diff(route.waypoints()[:, :2], axis=0), axis=1)
        assert np.all((steps > 4.9) & (steps < 5.0 + 1e-9))
        # The S of two arcs turns no more than a lane change at speed may.
        assert np.abs(route.segments[:, 3]).max() < np.abs(graph.curvature[[lane, beside]]).max() + 0.02


def test_path_for_the_traffic_names_the_lane_that_is_left_until_its_border_is_crossed() -> None:
    graph = GRAPHS["town03"]
    lane = int(np.flatnonzero((graph.right >= 0) & (graph.length > 60.0))[0])
    route = Route.planned(graph, np.array([lane, graph.right[lane]]), 3.0, 55.0)
    for _ in range(80):
        x, y, _ = route.poses(np.array([route.position + 0.5]))[0]
        route.advance(x, y)
        lateral = lane_project(graph, lane, x, y)[1]
        if lateral < 0.45 * graph.width[lane]:
            assert route.lanes_ahead[:2].tolist() == [lane, graph.right[lane]]
        elif lateral > 0.55 * graph.width[lane]:
            assert route.lanes_ahead[0] == graph.right[lane]


@pytest.mark.parametrize("name", sorted(GRAPHS))
def test_random_routes_leave_lanes_that_end_and_never_stop(name: str) -> None:
    graph = GRAPHS[name]
    room = dead_end_distance(graph)
    rng = np.random.default_rng(2)
    ending = np.flatnonzero(np.isfinite(room) & (room > 75.0))
    lanes = [*rng.choice(graph.length.size, 15), *(rng.choice(ending, 10) if ending.size else [])]
    for lane in lanes:
        if room[lane] < 75.0:
            continue
        route = Route(graph, int(lane), 0.0, rng)
        for _ in range(60):
            assert largest_break(route) < 1e-3
            assert np.abs(route.segments[:, 3]).max() < 0.16
            assert route.starts[-1] - route.position > 75.0
            x, y, _ = route.poses(np.array([route.position + 10.0]))[0]
            route.advance(x, y)


def test_dead_end_distance_is_measured_to_where_all_paths_end() -> None:
    fields = {"length": np.array([10.0, 20.0, 5.0, 7.0]), "successor_start": np.array([0, 2, 3, 3, 4])}
    # 0 leads to 1 and 2, 1 to 2, 2 to nowhere, 3 to itself.
    graph = GRAPHS["town03"]._replace(**fields, successor=np.array([1, 2, 2, 3]))
    np.testing.assert_array_equal(dead_end_distance(graph), [35.0, 25.0, 5.0, np.inf])


def test_environments_have_routes_of_their_own() -> None:
    graph = GRAPHS["town03"]
    routes = new_routes(graph, 3)
    for environment, lane in enumerate((3, 7, 11)):
        start(graph, routes, environment, lane, 1.0, np.uint64(5), NO_PLAN, 0.0)
    before = [np.array(Route.of_environment(graph, routes, e).segments) for e in (0, 2)]
    middle = Route.of_environment(graph, routes, 1)
    for _ in range(40):
        x, y, _ = middle.poses(np.array([middle.position + 10.0]))[0]
        middle.advance(x, y)
    for segments, e in zip(before, (0, 2), strict=True):
        np.testing.assert_array_equal(Route.of_environment(graph, routes, e).segments, segments)
    alone = new_routes(graph, 1)
    start(graph, alone, 0, 7, 1.0, np.uint64(5), NO_PLAN, 0.0)
    again = Route.of_environment(graph, alone, 0)
    for _ in range(40):
        x, y, _ = again.poses(np.array([again.position + 10.0]))[0]
        again.advance(x, y)
    np.testing.assert_array_equal(again.segments, middle.segments)
