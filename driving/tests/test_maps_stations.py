"""Stations, heights and names as files write them are read as they are meant."""

import math
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.maps import MapError, load_town
from athrl_driving.maps.opendrive.carriageways import DEFAULT_LIMIT

from driving.tests import written_maps
from driving.tests.faulty_maps import (
    ARC,
    HALF_CIRCLE,
    geometry,
    kinds,
    metres,
    ring,
    road,
    section,
    town_from,
)

AROUND = 400.0 + 2.0 * math.pi * (30.0 + 1.75)
"""Metres of the ring's lane."""


@pytest.mark.parametrize("rounding", [0.0, 5e-10, 5e-8, 5e-7, 2e-6, -5e-10, -5e-8, -5e-7])
def test_a_lane_follows_its_own_geometry_however_stations_are_rounded(
    tmp_path: Path, rounding: float
) -> None:
    """A section that begins a hair before its arc was laid along the line in front of the arc."""
    line, arc = geometry(0, 100.0, 0.0, 0.0, 100.0), geometry(100.0 + rounding, 200, 0, 0.0, HALF_CIRCLE, ARC)
    first = road(1, geometry(0, 0.0, 0.0, 0.0, 100.0), length=100)
    bent = road(2, line + arc, length=100.0 + HALF_CIRCLE, sections=section() + section(s=100))
    usual = road(2, geometry(0, 200.0, 0.0, 0.0, HALF_CIRCLE, ARC), length=HALF_CIRCLE)
    text = ring(first).replace(usual, bent)
    town = town_from(tmp_path, text)
    assert metres(town) == pytest.approx(AROUND, abs=1e-4)
    assert not town.graph.enters.any()  # it is still a ring


def test_a_road_is_level_before_its_first_height(tmp_path: Path) -> None:
    slope = '<elevationProfile><elevation s="150" a="0" b="0.005" c="0" d="0"/></elevationProfile>'
    town = town_from(tmp_path, ring(road(1, geometry(0, 0.0, 0.0), before=slope)))
    assert not town.findings
    heights = town.graph.elevation, town.graph.elevation + town.graph.grade * town.graph.length
    assert np.min(heights) > -0.01
    assert np.max(heights) == pytest.approx(0.25, abs=0.01)


def test_of_two_heights_at_one_place_the_last_holds(tmp_path: Path) -> None:
    heights = "".join(
        f'<elevation s="{s}" a="{a}" b="0" c="0" d="0"/>' for s, a in ((0, 0), (90, 7), (90, 0))
    )
    text = ring(road(1, geometry(0, 0.0, 0.0), before=f"<elevationProfile>{heights}</elevationProfile>"))
    assert not town_from(tmp_path, text, strict=True).graph.elevation.any()


def test_a_speed_limit_ends_with_the_type_of_road_that_has_it(tmp_path: Path) -> None:
    types = '<type s="0" type="town"><speed max="30" unit="km/h"/></type><type s="120" type="rural"/>'
    graph = town_from(tmp_path, ring(road(1, geometry(0, 0.0, 0.0), before=types))).graph
    slow = np.isclose(graph.speed_limit, 30.0 / 3.6)
    assert graph.length[slow].sum() == pytest.approx(120.0)
    assert np.allclose(graph.speed_limit[~slow], DEFAULT_LIMIT)


def test_an_error_is_one_line_whatever_the_files_name(tmp_path: Path) -> None:
    path = tmp_path / "two\nlines.xodr"
    path.write_text(ring(road(1, geometry(0, 0.0, 0.0), length=300)))
    with pytest.raises(MapError, match=r"^two lines\.xodr: road 1, [^\n]+$"):
        load_town(path)


def test_two_junctions_with_one_id_lose_no_way(tmp_path: Path) -> None:
    text = written_maps.crossing()
    whole = town_from(tmp_path, text)
    begin = text.index('<junction id="9"')
    half = text.index("</connection>", text.index("</connection>", begin) + 1) + len("</connection>")
    town = town_from(tmp_path, f'{text[:half]}</junction><junction id="9" name="again">{text[half:]}')
    assert len(town.movements.length) == len(whole.movements.length) > 4
    assert kinds(town) == ["two junctions with the same id were read as one"]
