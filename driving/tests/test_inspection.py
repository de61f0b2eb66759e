"""A look at a map says what the file holds, what of it is driven and what is not, and draws both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pygame
import pytest
from athrl_driving.episode.room_for_vehicles import places_beside_an_ego
from athrl_driving.errors import DrivingError
from athrl_driving.inspection import draw_town, facts_of, suggested_vehicles, try_traffic
from athrl_driving.inspection.facts import ways_out
from athrl_driving.inspection.picture import IN_JUNCTION, LANE, LEFT_OUT, LIGHT
from athrl_driving.maps import TOWNS, load_town
from athrl_driving.maps.outlines import centre_lines
from athrl_driving.traffic.flow import patience
from athrl_driving.traffic.state import starting_places

HEAD = '<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="4"/>'
LANE_XML = (
    '<lane id="{id}" type="driving"><link><predecessor id="{id}"/><successor id="{id}"/></link>'
    '<width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>'
)
ROAD = (
    '<road id="{id}" length="{length}" junction="-1" name="road {id}">{link}<planView>'
    '<geometry s="0" x="{x}" y="0" hdg="0" length="{length}"><arc curvature="{curvature}"/></geometry>'
    '</planView><lanes><laneSection s="0"><right>{lanes}</right></laneSection></lanes></road>'
)
CIRCLE = 2.0 * np.pi * 60.0


def ring_and_stub(folder: Path) -> Path:
    """Write a map of a ring, and a road beside it that has neither a beginning nor an end."""
    own = '<link><{0} elementType="road" elementId="1" contactPoint="{1}"/></link>'
    link = (own.format("predecessor", "end") + own.format("successor", "start")).replace("</link><link>", "")
    lanes = LANE_XML.format(id=-1)
    ring = ROAD.format(id=1, length=CIRCLE, x=0, curvature=1.0 / 60.0, link=link, lanes=lanes)
    stub = ROAD.format(id=2, length=30.0, x=100, curvature=0.01, link="", lanes=lanes)
    path = folder / "ring.xodr"
    path.write_text(f"{HEAD}{ring}{stub}</OpenDRIVE>")
    return path


def colours(picture: Path) -> dict[tuple[int, int, int], int]:
    """Return how many pixels have which colour."""
    pixels = pygame.surfarray.array3d(pygame.image.load(picture)).reshape(-1, 3)
    values, counts = np.unique(pixels, axis=0, return_counts=True)
    return dict(zip(map(tuple, values.tolist()), counts.tolist(), strict=True))


def test_facts_tell_what_is_driven_and_what_is_left_out(tmp_path: Path) -> None:
    facts = facts_of(load_town(ring_and_stub(tmp_path)))
    assert (facts.name, facts.opendrive, facts.roads) == ("ring", "1.4", 2)
    assert facts.extent == pytest.approx((127.0, 127.0), abs=0.2)
    (lost,) = facts.left_out
    assert lost[:2] == ("road 2", -1)
    assert lost[2] == pytest.approx(30.0, abs=1.0) == facts.metres_left_out
    driven = 2.0 * np.pi * 61.75
    assert facts.driven.kilometres == pytest.approx(driven / 1000.0, rel=1e-3)
    assert facts.driven.share == pytest.approx(driven / (driven + lost[2]))
    assert facts.driven.parts == pytest.approx([driven / 1000.0], rel=1e-3)
    assert facts.lane_kilometres == pytest.approx((driven + lost[2]) / 1000.0)
    assert facts.faults == ()


@pytest.mark.parametrize("name", TOWNS)
def test_facts_of_a_town_are_those_of_its_file(name: str) -> None:
    town = load_town(name)
    facts = facts_of(town)
    assert facts.opendrive == "1.6"
    assert facts.driven.share == 1.0
    assert facts.driven.kilometres == pytest.approx(town.lane_kilometres, rel=0.01)
    assert len(facts.driven.parts) == 1
    assert facts.traffic_lights == {"town04": 10}.get(name, 0)
    assert facts.driven.vehicle_places == places_beside_an_ego(town)
    assert 0 < suggested_vehicles(town) < places_beside_an_ego(town) < starting_places(town)


def test_file_without_a_header_has_no_revision(tmp_path: Path) -> None:
    path = ring_and_stub(tmp_path)
    path.write_text(path.read_text().replace('<header revMajor="1" revMinor="4"/>', ""))
    assert load_town(path).revision == ""


def test_picture_shows_lanes_and_what_is_left_out_in_another_colour(tmp_path: Path) -> None:
    picture = tmp_path / "ring.png"
    draw_town(load_town(ring_and_stub(tmp_path)), picture)
    shown = colours(picture)
    assert shown[LANE] > 15 * shown[LEFT_OUT] > 0
    assert IN_JUNCTION not in shown


def test_picture_of_a_town_shows_its_junctions_and_lights(tmp_path: Path) -> None:
    picture = tmp_path / "town04.png"
    draw_town(load_town("town04"), picture)
    shown = colours(picture)
    assert min(shown[colour] for colour in (LANE, IN_JUNCTION, LIGHT)) > 100
    assert LEFT_OUT not in shown


def test_picture_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(DrivingError, match=r"gone/ring\.png: the picture could not be written"):
        draw_town(load_town("town02"), tmp_path / "gone" / "ring.png")


def test_shapes_of_what_is_left_out_lie_where_the_file_has_them(tmp_path: Path) -> None:
    town = load_town(ring_and_stub(tmp_path))
    points = np.concatenate(centre_lines(town.left_out_shapes, spacing=2.0))
    assert points[:, 0].min() == pytest.approx(100.0, abs=0.1)
    assert np.hypot(*np.diff(points, axis=0).T).max() <= 2.0


def test_suggested_traffic_flows_in_every_town() -> None:
    town = load_town("town02")
    trial = try_traffic(town, suggested_vehicles(town))
    assert trial.vehicles == suggested_vehicles(town)
    assert trial.overlap_seconds == 0.0
    assert trial.stuck == 0
    assert trial.share_of_free_flow > 0.5
    assert trial.seconds == 60.0


def test_nobody_counts_as_stuck_for_waiting_at_a_red_light() -> None:
    assert patience(load_town("town02")) == 30.0
    town = load_town("town04")
    red = (town.signals.cycle - 15.0).max()
    assert patience(town) == pytest.approx(30.0 + red)
    assert try_traffic(town, 50).seconds == pytest.approx(60.0 + red)


def test_lane_that_nothing_follows_is_a_way_out_unless_its_vehicles_have_to_change() -> None:
    graph = load_town("town04").graph
    assert graph.dead_end.any()
    assert not ways_out(graph).size
    last = len(graph.length) - 1
    ends = graph.successor_start.copy()
    ends[last + 1] = ends[last]
    assert ways_out(graph._replace(successor_start=ends)).tolist() == [last]


def test_more_vehicles_than_there_is_room_for_are_refused() -> None:
    town = load_town("town02")
    with pytest.raises(DrivingError, match="room for 161 at most"):
        try_traffic(town, 162)
