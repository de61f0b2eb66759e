"""Lanes without links go on where their roads or sections do, as some programs write no links of lanes."""

from pathlib import Path

import numpy as np
import pytest
from athrl_driving.maps import MapError, load_town
from athrl_driving.maps.opendrive.unlinked import FOUND, NOT_LINKED

from driving.tests.faulty_maps import (
    LINKS,
    geometry,
    kinds,
    lane,
    link,
    metres,
    ring,
    road,
    section,
    town_from,
)


def two_sections(*second: str) -> str:
    """Return the ring whose road 1 has two sections; the lanes of the second are `second`."""
    first = section(lane(links='<link><predecessor id="-1"/></link>'))
    return ring(road(1, geometry(0, 0, 0), sections=first + section(*second, s=90)))


def test_sections_of_a_road_are_linked(tmp_path: Path) -> None:
    town = town_from(tmp_path, two_sections(lane(links='<link><successor id="-1"/></link>')))
    assert kinds(town) == [FOUND]
    assert metres(town) == pytest.approx(metres(town_from(tmp_path, ring())), abs=1e-6)
    assert not town.graph.leaves.any()


def test_roads_that_are_linked_are_linked_lane_by_lane(tmp_path: Path) -> None:
    town = town_from(tmp_path, ring().replace(LINKS, "<link/>"))
    assert [finding.place.split(",")[0] for finding in town.findings] == [f"road {n}" for n in (1, 2, 3, 4)]
    assert metres(town) == pytest.approx(metres(town_from(tmp_path, ring())), abs=1e-6)


def test_such_a_map_is_refused_where_it_is_read_strictly(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="without a link of lanes"):
        town_from(tmp_path, ring().replace(LINKS, "<link/>"), strict=True)


def test_roads_that_no_link_names_stay_apart(tmp_path: Path) -> None:
    """They meet, but may be on two levels of a drawing, or a border that nobody may cross."""
    alone = "".join(
        road(number, geometry(0, x, 0.0, 0.0, 300.0), length=300, links="<!-- none -->")
        for number, x in ((1, 0.0), (2, 300.0))
    )
    town = town_from(tmp_path, f"<OpenDRIVE>{alone}</OpenDRIVE>")
    assert {finding.kind for finding in town.findings} == {NOT_LINKED}
    assert town.graph.leaves.sum() == 2


def test_a_lane_ends_that_has_no_link_beside_one_that_has(tmp_path: Path) -> None:
    first = section(lane(), lane(-2, links="<link/>"))
    second = section(lane(), lane(-2, links="<link/>"), s=90)
    town = town_from(tmp_path, ring(road(1, geometry(0, 0, 0), sections=first + second)))
    assert FOUND not in kinds(town)
    assert town.lane_id[town.graph.dead_end].tolist() == [-2, -2]


@pytest.mark.parametrize("heading", [0.0, 0.3])
def test_lanes_that_meet_at_an_angle_are_not_linked(tmp_path: Path, heading: float) -> None:
    alone = road(1, geometry(0, 0.0, 0.0, 0.0, 300.0), length=300, links=link("successor", 2, "start"))
    alone += road(2, geometry(0, 300.0, 0.0, heading, 300.0), length=300, links=link("predecessor", 1, "end"))
    town = town_from(tmp_path, f"<OpenDRIVE>{alone}</OpenDRIVE>".replace(LINKS, "<link/>"))
    assert kinds(town) == ([] if heading else [FOUND])
    assert np.count_nonzero(town.graph.leaves) == (2 if heading else 1)


def test_no_town_has_lanes_without_links() -> None:
    for name in ("town02", "town03", "town04"):
        assert not load_town(name).findings
