"""With left-hand traffic everything is the mirror image of right-hand traffic.

The maps are the project's own towns, mirrored as files: coordinates, curvatures, lanes and the rule of the
road; what is compared is what the loader, the traffic and a driver make of both.
"""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.drivers import RuleBasedDriver
from athrl_driving.envs import TownEnv
from athrl_driving.maps import Town, load_town
from athrl_driving.maps.lane_graph import TURN_LEFT, TURN_RIGHT, TURN_STRAIGHT
from athrl_driving.scenarios import SCENARIOS
from athrl_driving.traffic.flow import measure_flow
from athrl_driving.traffic.state import new_traffic
from lxml import etree

TOWNS = Path(load_town.__code__.co_filename).parent / "towns"
MIRRORED_TURN = {TURN_LEFT: TURN_RIGHT, TURN_STRAIGHT: TURN_STRAIGHT, TURN_RIGHT: TURN_LEFT}
NEGATED = {
    "geometry": ("y", "hdg"),
    "arc": ("curvature",),
    "laneOffset": ("a", "b", "c", "d"),
    "lane": ("id",),
    "predecessor": ("id",),
    "successor": ("id",),
    "laneLink": ("from", "to"),
    "signal": ("t",),
    "validity": ("fromLane", "toLane"),
}


def negated(number: str) -> str:
    return number[1:] if number.startswith("-") else f"-{number}"


@pytest.fixture(scope="module")
def mirrored(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Write the mirror image of a town, driven on the left; only element names of our own files are known."""
    folder = tmp_path_factory.mktemp("mirrored")

    def write(name: str) -> Path:
        path = folder / f"{name}.xodr"
        tree = etree.parse(TOWNS / f"{name}.xodr")
        for road in tree.iter("road"):
            assert road.get("rule") == "RHT"
            road.set("rule", "LHT")
        for element in tree.iter(*NEGATED):
            for attribute in NEGATED[element.tag]:
                if attribute in element.attrib:  # roads are linked by elementId, lanes by id
                    element.set(attribute, negated(element.get(attribute)))
        for section in tree.iter("laneSection"):
            sides = {side.tag: side for side in section}
            for tag, other in (("left", "right"), ("right", "left")):
                if tag in sides:
                    sides[tag].tag = other
                    sides[tag][:] = reversed(sides[tag])
            section[:] = sorted(section, key=lambda side: ("left", "center", "right").index(side.tag))
        tree.write(path)
        return path

    return write


def ends(town: Town, lane: int) -> tuple[float, ...]:
    """Return the pose where a lane starts: x, y (m) and the heading's cosine and sine, rounded."""
    graph = town.graph
    heading = graph.start_heading[lane]
    return tuple(
        round(float(number), 3) + 0.0
        for number in (graph.start_x[lane], graph.start_y[lane], math.cos(heading), math.sin(heading))
    )


def mirror(pose: tuple[float, ...]) -> tuple[float, ...]:
    x, y, cosine, sine = pose
    return x, -y + 0.0, cosine, -sine + 0.0


def movements_of(town: Town) -> dict[tuple, tuple[int, int, bool, float]]:
    """Return by origin and exit of every movement: turn, priority, whether it yields, arrival penalty (s)."""
    movements, graph = town.movements, town.graph
    penalty = new_traffic(town, 1, 1).lane_links.arrival_penalty
    return {
        (ends(town, int(movements.origin[movement])), ends(town, int(movements.exit[movement]))): (
            int(graph.turn[movements.lane[movements.lane_start[movement]]]),
            int(movements.priority[movement]),
            bool(movements.yields[movement]),
            float(penalty[movement]),
        )
        for movement in range(movements.origin.size)
    }


@pytest.mark.parametrize("name", ["town03", "town04"])
def test_oncoming_lanes_lie_on_the_drivers_right(name: str, mirrored: Callable[[str], Path]) -> None:
    for town, side in ((load_town(name), -1), (load_town(mirrored(name)), 1)):
        graph, names = town.graph, np.array(town.road_name)
        seen = 0
        for lane in np.flatnonzero(graph.junction < 0).tolist():
            heading = float(graph.start_heading[lane])
            oncoming = np.flatnonzero(
                (names == names[lane])
                & (graph.junction < 0)
                & (town.lane_id * town.lane_id[lane] < 0)
                & (np.abs(np.cos(graph.start_heading - heading) + 1.0) < 1e-6)
                & (graph.curvature == 0.0)
            )
            dx = graph.start_x[oncoming] - graph.start_x[lane]
            dy = graph.start_y[oncoming] - graph.start_y[lane]
            lateral = dy * math.cos(heading) - dx * math.sin(heading)
            beside = (abs(lateral) > 1.0) & (abs(lateral) < 30.0)
            seen += int(beside.sum())
            assert (np.sign(lateral[beside]) == side).all()
        assert seen > 20


@pytest.mark.parametrize("name", ["town02", "town03", "town04"])
def test_priorities_are_mirrored(name: str, mirrored: Callable[[str], Path]) -> None:
    right, left = movements_of(load_town(name)), movements_of(load_town(mirrored(name)))
    assert left == {
        (mirror(origin), mirror(target)): (MIRRORED_TURN[turn], *others)
        for (origin, target), (turn, *others) in right.items()
    }
    # Right turns cross the oncoming traffic, and wait for it.
    across = [priority for turn, priority, yields, _ in left.values() if turn == TURN_RIGHT and not yields]
    assert across
    assert all(priority in (1, 3) for priority in across)


@pytest.mark.parametrize("name", ["town03", "town04"])
def test_changes_of_lane_are_mirrored(name: str, mirrored: Callable[[str], Path]) -> None:
    one, other = load_town(name), load_town(mirrored(name))

    def changes(town: Town, side: np.ndarray) -> set[tuple]:
        return {
            (ends(town, lane), ends(town, int(side[lane]))) for lane in np.flatnonzero(side >= 0).tolist()
        }

    for side, mirrored_side in ((one.graph.left, other.graph.right), (one.graph.right, other.graph.left)):
        expected = {(mirror(lane), mirror(beside)) for lane, beside in changes(one, side)}
        assert expected
        assert changes(other, mirrored_side) == expected


@pytest.mark.slow
@pytest.mark.parametrize("name", ["town03", "town04"])
def test_traffic_flows_as_on_the_right(name: str, mirrored: Callable[[str], Path]) -> None:
    flow = measure_flow(load_town(mirrored(name)), vehicles=100, seed=0, minutes=5.0)
    assert flow.colliding_pairs == 0
    assert flow.share_of_free_flow > 0.8
    assert flow.longest_standstill < 60.0


@pytest.mark.parametrize("name", sorted(SCENARIOS))
def test_the_rule_based_driver_passes_the_mirrored_case_studies(
    name: str, mirrored: Callable[[str], Path]
) -> None:
    case = SCENARIOS[name]
    places = {key: (case[key][0], -case[key][1], case[key][2]) for key in ("start", "destination")}
    x, y, radius = case["traffic_near"]
    config = {**case, **places, "town": str(mirrored("town03")), "traffic_near": (x, -y, radius)}
    env, driver = TownEnv(config=config), RuleBasedDriver()
    for seed in range(3):
        env.reset(seed=seed)
        driver.reset(env, seed)
        ended = False
        while not ended:
            _, _, terminated, truncated, info = env.step(driver.act(env))
            ended = terminated or truncated
        assert info["metrics"]["route_completion"] == info["metrics"]["success"] == 1.0, f"seed {seed}"
