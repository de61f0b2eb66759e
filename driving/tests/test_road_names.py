"""A road is named by its name, and by its id where others have that name too."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.episode.starts import Journeys, place_on_map
from athrl_driving.errors import DrivingError
from athrl_driving.inspection import facts_of
from athrl_driving.maps import Town, load_town

from driving.tests.small_map import SmallMap


def crossing(folder: Path, name: str) -> Town:
    """Four arms of two lanes, all roads with one name; with none where it is empty."""
    small_map = SmallMap()
    small_map.crossing([100.0] * 4)
    path = small_map.write(folder)
    text = re.sub(r'<road ([^>]*?)name="[^"]*"', r"<road \1", path.read_text())
    path.write_text(text.replace("<road ", f'<road name="{name}" ') if name else text)
    return load_town(path)


def test_lanes_are_counted_by_their_roads_whatever_those_are_called(tmp_path: Path) -> None:
    counted = [facts_of(crossing(tmp_path, name)).driven.lanes for name in ("", "Main")]
    assert counted[0] == counted[1] == 20


def test_a_name_that_roads_share_is_no_place_and_the_error_lists_their_ids(tmp_path: Path) -> None:
    town = crossing(tmp_path, "Main")
    with pytest.raises(
        DrivingError, match=r"^\d+ roads of small with such a lane are called 'Main', "
    ) as caught:
        place_on_map(town, ("Main", -1, 10.0))
    assert "should name one of them by its id: 'road 0', 'road 1', 'road 2'" in str(caught.value)


def test_a_road_is_found_by_its_id(tmp_path: Path) -> None:
    named, unnamed = crossing(tmp_path, "Main"), crossing(tmp_path, "")
    for road in ("road 0", "road 3"):
        assert place_on_map(named, (road, -1, 10.0)) == place_on_map(unnamed, (road, -1, 10.0))


def test_roads_of_one_name_that_follow_each_other_are_one_street(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.road(1, (0.0, 0.0, 0.0), [(300.0, 0.0)], after=(2, "start"))
    small_map.road(2, (300.0, 0.0, 0.0), [(300.0, 0.0)], before=(1, "end"))
    path = small_map.write(tmp_path)
    path.write_text(re.sub(r'name="[^"]*"', "", path.read_text()).replace("<road ", '<road name="Main" '))
    town = load_town(path)
    lane, s = place_on_map(town, ("Main", -1, 310.0))
    assert town.road_id[lane] == "2"
    assert s == pytest.approx(10.0, abs=0.1)


def test_lanes_that_are_left_out_are_told_by_id_where_roads_share_a_name(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.ring(1, 0.0)
    small_map.road(7, (500.0, 500.0, 0.0), [(30.0, 0.0)])
    path = small_map.write(tmp_path)
    path.write_text(re.sub(r'name="[^"]*"', "", path.read_text()).replace("<road ", '<road name="Main" '))
    assert {road for road, *_ in load_town(path).left_out} == {"Main (road 7)"}


def test_a_way_that_there_is_not_is_told_by_roads_and_lanes(tmp_path: Path) -> None:
    town = crossing(tmp_path, "")
    start, destination = (place_on_map(town, ("road 0", lane, 10.0)) for lane in (-1, 1))
    journeys = Journeys(town, 50.0, start, destination)
    with pytest.raises(DrivingError) as caught:
        journeys.draw(np.random.default_rng(0))
    assert str(caught.value) == "on the map small no way leads from lane -1 of road 0 to lane 1 of road 0"
