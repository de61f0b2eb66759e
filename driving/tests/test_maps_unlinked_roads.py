"""Whoever forgets a link in a map is told where two lanes meet without one."""

from __future__ import annotations

from pathlib import Path

import pytest
from athrl_driving.maps import Town
from athrl_driving.maps.opendrive.unlinked import NOT_LINKED

from driving.tests.small_map import SmallMap


def places(town: Town) -> list[str]:
    return [finding.place for finding in town.findings if finding.kind == NOT_LINKED]


def two_roads(gap: tuple[float, float, float], linked: bool) -> SmallMap:
    """Two straights in a line, the second moved by (ahead, aside, turned); both ends are edges of the map."""
    small_map = SmallMap()
    after, before = ((2, "start"), (1, "end")) if linked else (None, None)
    small_map.road(1, (0.0, 0.0, 0.0), [(100.0, 0.0)], after=after)
    ahead, aside, turned = gap
    small_map.road(2, (100.0 + ahead, aside, turned), [(100.0, 0.0)], before=before)
    return small_map


def test_a_missing_link_is_told_for_both_directions(tmp_path: Path) -> None:
    assert places(two_roads((0.0, 0.0, 0.0), linked=False).load(tmp_path)) == [
        "road 1, lane -1, and road 2, lane -1",
        "road 2, lane 1, and road 1, lane 1",
    ]


def test_nothing_is_told_where_lanes_are_linked(tmp_path: Path) -> None:
    assert not places(two_roads((0.0, 0.0, 0.0), linked=True).load(tmp_path))


@pytest.mark.parametrize("gap", [(0.5, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 0.4)])
def test_nothing_is_told_of_lanes_that_do_not_meet(tmp_path: Path, gap: tuple[float, float, float]) -> None:
    assert not places(two_roads(gap, linked=False).load(tmp_path))
