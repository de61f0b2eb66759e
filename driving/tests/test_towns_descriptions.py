"""What describing and drawing a town of one's own promises."""

import math
import sys
from pathlib import Path

import pytest

DRIVING = Path(__file__).parents[1]
sys.path.insert(0, str(DRIVING))

from athrl_driving.maps.making.curves import Pose, join  # noqa: E402
from athrl_driving.maps.making.description import (  # noqa: E402
    Bend,
    Bridge,
    Gore,
    Motorway,
    Node,
    Road,
    Roundabout,
    Town,
)
from athrl_driving.maps.making.laying import lay_town  # noqa: E402
from athrl_driving.maps.making.writing import opendrive_text  # noqa: E402
from towns.drawing import draw  # noqa: E402

SQUARE = (Node("a", 0.0, 0.0), Node("b", 100.0, 0.0), Node("c", 0.0, 100.0))
LOOPS = (
    Road("a", "b"),
    Road("a", "b", bends=(Bend(0.0, 60.0, 20.0), Bend(100.0, 60.0, 20.0))),
    Road("a", "b", bends=(Bend(0.0, -60.0, 20.0), Bend(100.0, -60.0, 20.0))),
)


@pytest.mark.parametrize(
    ("nodes", "roads", "message"),
    [
        (SQUARE, (Road("a", "x"),), "road a - x: there is no node named x"),
        (SQUARE, (Road("a", "b"), Road("a", "c")), "node a: 2 roads meet there"),
        (
            SQUARE[:2],
            (LOOPS[0], Road("a", "b", bends=(Bend(0.0, 12.0, 5.0), Bend(100.0, 12.0, 5.0))), LOOPS[2]),
            "road a - b: it must be straight for 1[01].* m at a node",
        ),
        (
            SQUARE[:2],
            (*LOOPS, Road("a", "b", bends=(Bend(50.0, 10.0, 20.0),))),
            "node a: two roads are only 11",
        ),
        (SQUARE, (Road("a", "b", bends=(Bend(50.0, 90.0, 90.0),)),), "road a - b: the bend at"),
        (
            (Roundabout("a", 0.0, 0.0, 22.0), SQUARE[1]),
            LOOPS,
            "node a: every road at a roundabout needs 2 lanes in and out",
        ),
    ],
)
def test_a_description_that_cannot_be_built_names_the_place(
    nodes: tuple[Node, ...], roads: tuple[Road, ...], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        lay_town(Town("broken", nodes, roads))


RING = tuple(
    Bend(x, y, 150.0) for x, y in ((400.0, 400.0), (400.0, -400.0), (-400.0, -400.0), (-400.0, 400.0))
)
LEAVES, JOINS = Gore("off", -100.0, -400.0, leaves=True), Gore("on", -300.0, 100.0, leaves=False)


@pytest.mark.parametrize(
    ("gores", "bridges", "message"),
    [
        ((LEAVES, JOINS), (), "gore off: 0 ramps, not 1"),
        ((LEAVES, Gore("next", -150.0, -400.0, leaves=True)), (), "gore off: 10 m to the next gore, 25 m"),
        ((JOINS, Gore("next", -400.0, 240.0, leaves=True)), (), "gore on: 100 m to the next gore, 215 m"),
        ((LEAVES,), (Bridge(-200.0, -400.0, 6.5, 30.0, 140.0),), "motorway ring: no room for the bridge at"),
        ((LEAVES,), (Bridge(-120.0, -400.0, 6.5, 30.0, 140.0),), "motorway ring: a bridge lies on a gore"),
    ],
)
def test_a_motorway_that_cannot_be_built_names_the_place(
    gores: tuple[Gore, ...], bridges: tuple[Bridge, ...], message: str
) -> None:
    motorway = Motorway("ring", RING, lanes=3, mph=60, gores=gores, bridges=bridges)
    with pytest.raises(ValueError, match=message):
        lay_town(Town("broken", SQUARE[:2], LOOPS, motorways=(motorway,)))


def test_minor_roads_give_way_to_major_ones() -> None:
    roads = (LOOPS[0], *(Road("a", "b", bends=road.bends, major=True) for road in LOOPS[1:]))
    plan = lay_town(Town("small", SQUARE[:2], roads))
    for junction in plan.junctions:
        minor = {c.road.number for c in junction.connections if c.incoming.road.number == 1}
        assert {low for _, low in junction.priorities} == minor


@pytest.mark.parametrize("turn", [-1.6, -1.0, 0.3, math.pi / 2.0])
def test_two_poses_are_joined_without_a_jump(turn: float) -> None:
    start, end = Pose(3.0, 4.0, 0.7), Pose(60.0, 50.0, 0.7 + turn)
    pieces = join(start, end, 8.0)
    at = start
    for piece in pieces:
        assert math.hypot(piece.start.x - at.x, piece.start.y - at.y) < 1e-9
        assert abs(math.remainder(piece.start.heading - at.heading, 2.0 * math.pi)) < 1e-9
        at = piece.end
    assert math.hypot(end.x - at.x, end.y - at.y) < 1e-9
    assert abs(math.remainder(end.heading - at.heading, 2.0 * math.pi)) < 1e-9


def test_a_file_is_drawn(tmp_path: Path) -> None:
    file = tmp_path / "small.xodr"
    file.write_text(opendrive_text(lay_town(Town("small", SQUARE[:2], LOOPS))))
    draw(file, tmp_path / "small.png", credit="")
    assert (tmp_path / "small.png").read_bytes().startswith(b"\x89PNG")
