"""Short roads keep what they join: those of no length, and those that leave the map close to a junction."""

import math
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.inspection.facts import ways_out
from athrl_driving.maps import MapError

from driving.tests.faulty_maps import geometry, kinds, link, metres, ring, road, section, town_from
from driving.tests.small_map import SmallMap

NO_LENGTH = "a road of no length was read as a link between those that it is linked to"


def joined(length: float, shape: str = "<line/>", sections: str = "") -> str:
    """Return the ring with a road 5 of this length between roads 4 and 1."""
    links = link("predecessor", 4, "end") + link("successor", 1, "start")
    first = link("predecessor", 5, "end") + link("successor", 2, "start")
    text = ring(
        road(1, geometry(0, 0.0, 0.0), links=first),
        road(5, geometry(0, 0.0, 0.0, 0.0, length, shape), length=length, links=links, sections=sections),
    )
    before = link("predecessor", 3, "end")
    return text.replace(before + link("successor", 1, "start"), before + link("successor", 5, "start"))


@pytest.mark.parametrize("length", [0.0, 1e-12, 1e-7, 1e-6, 9e-6, 1e-5, 1e-4, 0.01])
def test_a_road_of_hardly_any_length_joins_its_neighbours(tmp_path: Path, length: float) -> None:
    town = town_from(tmp_path, joined(length))
    assert metres(town) == pytest.approx(metres(town_from(tmp_path, ring())), abs=0.02)
    assert kinds(town) == ([] if length else [NO_LENGTH])
    assert town.left_out == ()
    assert ways_out(town.graph).size == 0, "the ring is closed"


@pytest.mark.parametrize(
    "shape",
    ['<arc curvature="0.1"/>', '<spiral curvStart="0" curvEnd="1"/>', '<poly3 a="0" b="0" c="0" d="0"/>',
     '<paramPoly3 aU="0" bU="0" cU="0" dU="0" aV="0" bV="0" cV="0" dV="0" pRange="normalized"/>'],
)  # fmt: skip
def test_its_shape_and_its_sections_do_not_matter(tmp_path: Path, shape: str) -> None:
    town = town_from(tmp_path, joined(0.0, shape, section() + section(s=0)))
    assert kinds(town) == [NO_LENGTH]
    assert metres(town) == pytest.approx(metres(town_from(tmp_path, ring())))


def test_a_strict_map_has_none(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"^map.xodr: road 5, line \d+: a road of no length .+ read strictly$"):
        town_from(tmp_path, joined(0.0), strict=True)


# Roads that leave the map close to a junction

PROLONGED = "a road that ends at the map's edge close to a junction was prolonged to be of use"


@pytest.mark.parametrize("arms", [(100, 100, 100, 8), (100, 100, 11, 1), (10, 10, 10, 10)])
def test_a_short_arm_at_the_edge_of_the_map_is_left_and_entered(
    tmp_path: Path, arms: tuple[int, ...]
) -> None:
    crossing = SmallMap()
    crossing.crossing(arms)
    town = crossing.load(tmp_path)
    assert (kinds(town), town.left_out) == ([PROLONGED], ())
    assert len(town.movements.origin) == 12
    roads = np.sort(town.graph.length[town.graph.movement < 0])
    assert roads == pytest.approx(np.sort([max(arm, 12) for arm in arms] * 2), 1e-3)
    assert len(ways_out(town.graph)) == 4


@pytest.mark.parametrize("lanes", [(-1,), (1,), (2, 1, -1, -2)])
@pytest.mark.parametrize("beyond", [9.0, 13.0, 15.0])
def test_a_road_that_ends_close_behind_a_crossing_is_driven_to_its_end(
    tmp_path: Path, lanes: tuple[int, ...], beyond: float
) -> None:
    roads = SmallMap()
    roads.road(1, (-200.0, 0.0, 0.0), [(400.0, 0.0)], (-1,))
    roads.road(2, (0.0, -beyond, 0.5 * math.pi), [(200.0 + beyond, 0.0)], lanes)
    town = roads.load(tmp_path)
    assert town.left_out == ()
    assert PROLONGED in kinds(town)
    assert len(town.movements.origin) == 1 + len(lanes)


def test_a_road_is_prolonged_along_its_slope_and_its_bend(tmp_path: Path) -> None:
    hill = '<elevationProfile><elevation s="0" a="1" b="0.1" c="0" d="0"/></elevationProfile>'
    crossing = SmallMap()
    crossing.crossing((50, 50, 50, 4))
    path = crossing.write(tmp_path)
    path.write_text(path.read_text().replace("<lanes>", f"{hill}<lanes>"))
    text = path.read_text().replace("<line/>", '<arc curvature="0.01"/>', 4)
    town = town_from(tmp_path, text)
    short = [lane for lane, name in enumerate(town.road_name) if name == "road 3"]
    assert town.graph.length[short] == pytest.approx(12.0, abs=0.01)
    assert abs(town.graph.grade[short]) == pytest.approx(0.1, rel=0.05)
    assert abs(town.graph.curvature[short]) == pytest.approx(0.01, rel=0.05)


def test_a_short_road_by_itself_is_not_prolonged(tmp_path: Path) -> None:
    roads = SmallMap()
    roads.road(1, (0.0, 0.0, 0.0), [(11.0, 0.0)])
    with pytest.raises(MapError, match=r"no lane is long enough to stand on: the longest .+ has 11.00 m"):
        roads.load(tmp_path)


def test_a_short_end_that_is_left_out_stays_as_it_is_in_the_file(tmp_path: Path) -> None:
    """A stub at a ring is no exit: the map stays closed, and it is among what is left out."""
    stub = geometry(0, 200.0, 0.0, length=5.0)
    text = ring("", road(5, stub, length=5, links=link("predecessor", 1, "end")))
    town, without = town_from(tmp_path, text), town_from(tmp_path, ring())
    assert (kinds(town), town.left_out) == ([], (("road 5", -1, pytest.approx(5.0)),))
    assert metres(town) == pytest.approx(metres(without))
    assert ways_out(town.graph).size == 0
