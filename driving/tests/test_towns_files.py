"""What the three towns' files promise; read from the files, without the package's loader."""

import math
import subprocess
import sys
from collections import Counter
from importlib.metadata import files
from pathlib import Path

import numpy as np
import pytest
import xmlschema

DRIVING = Path(__file__).parents[1]
sys.path.insert(0, str(DRIVING))

from towns.reading import Drawing, Lane, links, read  # noqa: E402

FOLDER = DRIVING / "athrl_driving" / "maps" / "towns"
NAMES = ("town02", "town03", "town04")
DRAWINGS = {name: read(FOLDER / f"{name}.xodr") for name in NAMES}

town = pytest.mark.parametrize("name", NAMES)


def driving(drawing: Drawing) -> list[Lane]:
    return [lane for lane in drawing.lanes if lane.kind == "driving"]


def arms(drawing: Drawing) -> list[int]:
    return [
        len(
            {
                link.get("elementId")
                for road in drawing.root.iterfind(f"road[@junction='{junction.get('id')}']")
                for link in road.find("link")
            }
        )
        for junction in drawing.root.iterfind("junction")
    ]


def heading(points: np.ndarray, first: int, second: int) -> float:
    return math.atan2(*(points[second] - points[first])[1::-1])


def test_the_script_reproduces_the_files_byte_for_byte(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "towns", "--folder", str(tmp_path)]
    subprocess.run(command, cwd=DRIVING, check=True, capture_output=True)
    for name in NAMES:
        assert (tmp_path / f"{name}.xodr").read_bytes() == (FOLDER / f"{name}.xodr").read_bytes()


def test_the_files_are_valid_opendrive() -> None:
    packaged = files("scenariogeneration") or []
    core = next(file for file in packaged if file.name == "opendrive_17_core.xsd")
    schema = xmlschema.XMLSchema(str(core.locate()))
    for name in NAMES:
        schema.validate(str(FOLDER / f"{name}.xodr"))


@town
def test_every_lane_link_closes(name: str) -> None:
    pairs = links(DRAWINGS[name])
    assert len(pairs) > 50
    for lane, following in pairs:
        for line in ("left", "middle", "right"):
            gap = getattr(lane, line)[-1] - getattr(following, line)[0]
            # A lane that ends beside narrows the shoulder, never a driving lane.
            assert np.abs(gap).max() < 1e-6, (lane.road_name, lane.number)


@town
def test_no_lane_link_bends(name: str) -> None:
    for lane, following in links(DRAWINGS[name]):
        if len(lane.middle) == len(following.middle) == 2:
            turn = heading(lane.middle, -2, -1) - heading(following.middle, 0, 1)
            assert abs(math.remainder(turn, 2.0 * math.pi)) < 1e-6, (lane.road_name, lane.number)


@town
def test_every_lane_can_be_reached_from_every_other(name: str) -> None:
    drawing = DRAWINGS[name]
    keys = {(lane.road, lane.section, lane.number): lane for lane in driving(drawing)}
    edges = [((a.road, a.section, a.number), (b.road, b.section, b.number)) for a, b in links(drawing)]
    for road, section, number in keys:
        other = (road, section, number + (1 if number > 0 else -1))
        if other in keys and keys[road, section, number].mark == "broken":
            edges += [((road, section, number), other), (other, (road, section, number))]
    for ordered in (edges, [(b, a) for a, b in edges]):
        following: dict[tuple[str, int, int], list[tuple[str, int, int]]] = {}
        for start, end in ordered:
            following.setdefault(start, []).append(end)
        found, waiting = set(), [next(iter(keys))]
        while waiting:
            key = waiting.pop()
            if key not in found:
                found.add(key)
                waiting.extend(following.get(key, []))
        assert found == set(keys)


@pytest.mark.parametrize(
    ("name", "kilometres", "extent"),
    [("town02", 2.85, (200, 200)), ("town03", 13.24, (643, 629)), ("town04", 33.15, (979, 875))],
)
def test_a_town_has_as_much_lane_as_carlas_and_the_extent_that_is_told(
    name: str, kilometres: float, extent: tuple[float, float]
) -> None:
    lanes = driving(DRAWINGS[name])
    assert sum(lane.length for lane in lanes) / 1000.0 == pytest.approx(kilometres, rel=0.03)
    points = np.vstack([line[:, :2] for lane in lanes for line in (lane.left, lane.right)])
    assert np.ptp(points, axis=0) == pytest.approx(extent, abs=1.0)


def test_each_town_has_its_junctions() -> None:
    assert Counter(arms(DRAWINGS["town02"])) == {3: 8}
    # Four of town03's are the roundabout's.
    assert Counter(arms(DRAWINGS["town03"])) == {3: 7 + 4, 4: 3, 5: 1}
    assert Counter(arms(DRAWINGS["town04"]))[4] >= 13


@town
def test_no_lane_is_too_tight_for_a_car(name: str) -> None:
    for road in DRAWINGS[name].root.iterfind("road"):
        lanes = [lane for lane in driving(DRAWINGS[name]) if lane.road == road.get("id")]
        # Lanes to either side of an arc are tighter by at most the road's half width.
        aside = 0.0 if road.get("junction") != "-1" else 3.5 * len(lanes) / 2.0
        for arc in road.iterfind("planView/geometry/arc"):
            assert 1.0 / abs(float(arc.attrib["curvature"])) - aside >= 8.0, road.get("name")


@town
def test_there_is_room_to_stand_between_junctions(name: str) -> None:
    for road in DRAWINGS[name].root.iterfind("road[@junction='-1']"):
        least = 12.0 if road.get("name") == "circle" else 25.0
        assert float(road.attrib["length"]) >= least, road.get("name")


@town
def test_priorities_are_between_roads_of_their_junction(name: str) -> None:
    root = DRAWINGS[name].root
    for junction in root.iterfind("junction"):
        connections = {
            c.get("connectingRoad"): c.get("incomingRoad") for c in junction.iterfind("connection")
        }
        pairs = [(p.get("high"), p.get("low")) for p in junction.iterfind("priority")]
        assert all(connections[high] != connections[low] for high, low in pairs)
        assert {high for high, _ in pairs}.isdisjoint(low for _, low in pairs)
    assert root.find("junction/priority") is not None


def test_entries_of_the_roundabout_yield_and_it_is_driven_counter_clockwise() -> None:
    root = DRAWINGS["town03"].root
    ring = {road.get("id"): road for road in root.iterfind("road[@name='circle']")}
    assert len(ring) == 4
    for road in ring.values():
        assert float(road.find("planView/geometry/arc").get("curvature")) == pytest.approx(1.0 / 22.0)
        numbers = [int(lane.get("id")) for lane in road.iter("lane") if lane.get("type") == "driving"]
        assert numbers == [-1, -2]
    entries = 0
    for junction in root.iterfind("junction"):
        if junction.get("name", "").startswith("circle"):
            low = {priority.get("low") for priority in junction.iterfind("priority")}
            for connection in junction.iterfind("connection"):
                enters = connection.get("incomingRoad") not in ring
                assert (connection.get("connectingRoad") in low) == enters
                entries += enters
    assert entries == 8


def test_the_named_places_are_there() -> None:
    root = DRAWINGS["town03"].root
    (meadow,) = root.iterfind("road[@name='Meadow Road']")
    (geometry,) = meadow.iterfind("planView/geometry")
    assert geometry.find("line") is not None
    assert float(geometry.get("length")) >= 150.0
    assert sorted(lane.number for lane in driving(DRAWINGS["town03"]) if lane.road == meadow.get("id")) == [
        -1,
        1,
    ]
    names = {road.get("id"): road.get("name") for road in root.iterfind("road")}
    (market,) = root.iterfind("junction[@name='market']")
    incoming = {names[connection.get("incomingRoad")] for connection in market.iterfind("connection")}
    assert incoming == {"Circle Road East", "Market Road", "Garden Street", "River Street"}
    assert market.find("controller") is None


def test_town04_passes_over_its_streets() -> None:
    lanes = driving(DRAWINGS["town04"])
    for street in ("West Underpass", "East Underpass"):
        below = next(lane for lane in lanes if lane.road_name == street)
        middle = below.middle.mean(axis=0)
        above = [
            lane.middle[np.abs(lane.middle[:, 1] - middle[1]).argmin(), 2]
            for lane in lanes
            if lane.road_name.startswith("Ring")
            and np.abs(lane.middle[:, :2] - middle[:2]).max(axis=1).min() < 20.0
        ]
        assert len(above) == 6
        assert min(above) - below.middle[:, 2].max() >= 6.0
    for lane in lanes:
        rise = np.abs(np.diff(lane.middle[:, 2])) / np.hypot(*np.diff(lane.middle[:, :2], axis=0).T)
        assert rise.max() < 0.08


def test_town04_has_acceleration_lanes_that_end_beside_a_lane() -> None:
    lanes = driving(DRAWINGS["town04"])
    ending = [lane for lane in lanes if lane.ends]
    assert len(ending) == 5
    for lane in ending:
        assert lane.length >= 100.0
        (beside,) = (
            other
            for other in lanes
            if (other.road, other.section, other.number) == (lane.road, lane.section, lane.number + 1)
        )
        assert beside.mark == "broken"


def test_town04_has_signals_for_every_lane_of_a_junction() -> None:
    root = DRAWINGS["town04"].root
    controlled = {
        controller.get("id"): [control.get("signalId") for control in controller.iterfind("control")]
        for controller in root.iterfind("controller")
    }
    signalled = [
        junction for junction in root.iterfind("junction") if junction.find("controller") is not None
    ]
    assert len(signalled) >= 2
    for junction in signalled:
        signals = [s for c in junction.iterfind("controller") for s in controlled[c.get("id")]]
        governed: Counter[tuple[str, int]] = Counter()
        for road in root.iterfind("road"):
            for signal in road.iterfind("signals/signal"):
                if signal.get("id") in signals:
                    assert signal.get("type") == "1000001"
                    validity = signal.find("validity")
                    for number in range(int(validity.get("fromLane")), int(validity.get("toLane")) + 1):
                        assert (number < 0) == (signal.get("orientation") == "+")
                        governed[road.get("id"), number] += 1
        entering = {
            (connection.get("incomingRoad"), int(connection.find("laneLink").get("from")))
            for connection in junction.iterfind("connection")
        }
        assert governed == dict.fromkeys(entering, 1)
