"""Short roads keep what they join: those of no length, and those that leave the map close to a junction."""

from pathlib import Path

import pytest
from athrl_driving.maps import MapError

from driving.tests.faulty_maps import geometry, kinds, link, metres, ring, road, section, town_from

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
    assert kinds(town) == ([NO_LENGTH] if length < 1e-5 else [])
    assert town.left_out == ()


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
