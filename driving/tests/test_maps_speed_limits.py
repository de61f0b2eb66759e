"""Speed limits of a map: how fast the traffic may drive, and which road is the main one."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from athrl_driving.maps.lane_graph import TURN_STRAIGHT
from athrl_driving.maps.opendrive.carriageways import DEFAULT_LIMIT
from athrl_driving.maps.opendrive.element_reader import WITHOUT_LIMIT
from athrl_driving.maps.priority import priorities

from driving.tests.written_maps import crossing, town_from


def limits(folder: Path, road: str, lane: str = "") -> set[float]:
    """The speed limits of a crossing whose roads and lanes have these elements."""
    text = crossing().replace("<planView", f"{road}<planView").replace("</lane>", f"{lane}</lane>")
    return set(np.round(town_from(folder, text).graph.speed_limit, 3).tolist())


def road_type(limit: str) -> str:
    return f'<type s="0" type="motorway"><speed max="{limit}" unit="km/h"/></type>'


def lane_speed(limit: str) -> str:
    return f'<speed sOffset="0" max="{limit}" unit="km/h"/>'


@pytest.mark.parametrize(
    ("road", "lane", "limit"),
    [
        ("", "", DEFAULT_LIMIT),
        (road_type("80"), "", 80 / 3.6),
        (road_type("80"), lane_speed("60"), 60 / 3.6),
        (road_type("80"), lane_speed("undefined"), 80 / 3.6),
        (road_type("undefined"), "", DEFAULT_LIMIT),
        (road_type("no limit"), "", WITHOUT_LIMIT),
        (road_type("80"), lane_speed("no limit"), WITHOUT_LIMIT),
    ],
)
def test_limit_is_the_lanes_else_the_roads(tmp_path: Path, road: str, lane: str, limit: float) -> None:
    assert limits(tmp_path, road, lane) == {round(limit, 3)}


class StraightRoad:
    """What priorities ask of a road."""

    left_hand_traffic = False


def movement(limit: float, lanes: int) -> Any:
    """A movement straight on from a road with a limit (m/s) and so many lanes at its stop line."""
    carriageway = SimpleNamespace(lanes=[None] * lanes, road=StraightRoad())
    return SimpleNamespace(origin=SimpleNamespace(limit=limit, carriageway=carriageway), junctions=["9"])


@pytest.mark.parametrize(
    ("fast", "slow", "minor"),
    [
        ((22.0, 1), (14.0, 2), "slow"),  # a pocket for turns does not make a side road the main one
        ((22.0, 2), (14.0, 1), "slow"),
        ((14.0, 1), (14.0, 2), "fast"),
        ((14.5, 1), (14.0, 2), "fast"),  # about equally fast: the narrower one
        ((14.0, 1), (14.0, 1), ""),
    ],
)
def test_slower_road_is_minor_and_of_equally_fast_ones_the_narrower(
    fast: tuple[float, int], slow: tuple[float, int], minor: str
) -> None:
    roads = {"fast": fast, "slow": slow}
    movements = [movement(*roads[name]) for name in roads for _ in range(2)]
    found = priorities(movements, np.full(4, TURN_STRAIGHT), np.zeros(4, np.bool_))
    expected = [2 * (name == minor) for name in roads for _ in range(2)]
    assert found.tolist() == expected
