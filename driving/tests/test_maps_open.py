"""Open maps: every part that can be driven is kept, and the ego's drive ends where the map does."""

import logging
import math
from pathlib import Path
from typing import Any

import athrl_driving  # noqa: F401  (registers the environments)
import gymnasium
import numpy as np
import pytest
from athrl_driving.drivers import RuleBasedDriver
from athrl_driving.envs import TownEnv, TownVectorEnv
from athrl_driving.episode.room_for_vehicles import places_beside_an_ego
from athrl_driving.maps import MapError, Town, load_town
from athrl_driving.route import Route
from athrl_driving.traffic import starting_places
from gymnasium.utils.env_checker import check_env

from driving.tests.small_map import SmallMap

FEW = {"vehicles_count": 4}


def metres(town: Town) -> float:
    """Return the metres of ordinary lanes."""
    return float(town.graph.length[town.graph.movement < 0].sum())


def test_a_road_across_the_map_enters_and_leaves_it_on_every_lane(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.road(1, (0, 0, 0), [(300, 0)], lanes=(2, 1, -1, -2))
    town = small_map.load(tmp_path)
    assert town.left_out == ()
    assert town.graph.enters.all()
    assert town.graph.leaves.all()
    assert not town.graph.dead_end.any()


def test_both_directions_of_a_ring_and_a_ring_apart_are_kept(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.ring(1, 0.0)
    small_map.ring(3, 500.0)
    town = small_map.load(tmp_path)
    assert town.left_out == ()
    assert metres(town) == pytest.approx(4 * (200.0 + 60.0 * math.pi), rel=1e-3)
    for flags in (town.graph.enters, town.graph.leaves, town.graph.dead_end):
        assert not flags.any()


def test_a_lane_that_ends_beside_one_that_goes_on_does_not_leave_the_map(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.road(1, (0, 0, 0), [(150, 0)], lanes=(-1, -2), after=(2, "start"))
    small_map.road(2, (150, 0, 0), [(150, 0)], lanes=(-1,), before=(1, "end"))
    # The link of lane -2 to a lane that is not there would be a mistake of the file.
    text = small_map.write(tmp_path).read_text()
    path = tmp_path / "merge.xodr"
    path.write_text(text.replace('<successor id="-2"/>', ""))
    town = load_town(path)
    assert town.left_out == ()
    assert sorted(town.lane_id[town.graph.enters]) == [-2, -1]
    assert town.lane_id[town.graph.dead_end].tolist() == [-2]
    assert [town.road_name[lane] for lane in np.flatnonzero(town.graph.leaves)] == ["road 2"]


@pytest.mark.parametrize(("length", "kept"), [(50.0, False), (190.0, False), (210.0, True)])
def test_a_piece_of_road_beside_a_loop_is_kept_if_it_is_long(
    tmp_path: Path, length: float, kept: bool
) -> None:
    small_map = SmallMap()
    small_map.ring(1, 0.0)
    small_map.road(5, (0, -100, 0), [(length, 0)], lanes=(-1,))
    town = small_map.load(tmp_path)
    assert ("road 5" in town.road_name) == kept
    assert town.left_out == (() if kept else (("road 5", -1, length),))


@pytest.mark.parametrize(("length", "level"), [(100.0, logging.WARNING), (15.0, logging.INFO)])
def test_what_is_left_out_is_told_once_and_loudly_if_it_is_much(
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    length: float,
    level: int,
) -> None:
    small_map = SmallMap()
    small_map.ring(1, 0.0)
    small_map.road(5, (0, -100, 0), [(length, 0)], lanes=(-1,))
    with caplog.at_level(logging.INFO, "athrl_driving.maps"):
        town = small_map.load(tmp_path)
        load_town(tmp_path / "small.xodr")
    (told,) = [record for record in caplog.records if "left out" in record.getMessage()]
    assert told.levelno == level
    share = 100.0 * length / (metres(town) + length)
    assert f"{length:.1f} m of 1 lane ({share:.1f} %) left out" in told.getMessage()
    assert "road 5" in told.getMessage()


def test_a_road_into_a_loop_that_nothing_leaves_is_left_out(tmp_path: Path) -> None:
    """Its vehicles would never come back to it, as none leaves the map."""
    small_map = SmallMap()
    small_map.ring(1, 0.0, lanes=(-1,))
    small_map.road(5, (-200, 0, 0), [(200, 0)], lanes=(-1,), after=(1, "start"))
    town = small_map.load(tmp_path)
    assert town.left_out == (("road 5", -1, 200.0),)
    assert not town.graph.enters.any()


def test_a_map_without_a_lane_to_drive_on_is_refused_in_one_line(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.road(1, (0, 0, 0), [(8.0, 0)])
    with pytest.raises(MapError, match=r"^small.xodr: [^\n]+$"):
        small_map.load(tmp_path)


def drive(env: Any, seed: int) -> tuple[bool, bool, dict[str, Any]]:
    """Let the rule-based driver drive an episode; return how it ended."""
    env.reset(seed=seed)
    driver = RuleBasedDriver()
    while True:
        _, _, terminated, truncated, info = env.step(driver.act(env.unwrapped))
        assert math.isfinite(info["speed"])
        assert info["speed"] < 15.0
        if terminated or truncated:
            return terminated, truncated, info


@pytest.mark.parametrize("vehicles", [0, 12])
def test_the_drive_ends_as_arrived_where_the_map_ends(tmp_path: Path, vehicles: int) -> None:
    small_map = SmallMap()
    small_map.crossing([100.0, 120.0, 90.0, 110.0])
    env = TownEnv({"vehicles_count": vehicles, "episode_ticks": 2000}, map=str(small_map.write(tmp_path)))
    for seed in range(4):
        terminated, truncated, info = drive(env, seed)
        assert (terminated, truncated) == (False, True)
        assert info["arrived"]
        assert info["route_end"]
        assert info["metrics"]["success"] == info["metrics"]["route_completion"] == 1.0
        x, y = env.vehicle.position
        assert 100.0 < max(abs(x), abs(y)) < 135.0


def test_the_time_limit_is_no_arrival(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.road(1, (0, 0, 0), [(2000, 0)])
    env = TownEnv({**FEW, "episode_ticks": 100}, map=str(small_map.write(tmp_path)))
    _, truncated, info = drive(env, 0)
    assert truncated
    assert not info["arrived"]
    assert not info["route_end"]


def test_a_destination_before_the_edge_is_reached_and_ends_the_task(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.road(1, (0, 0, 0), [(300, 0)])
    places = {"start": ("road 1", -1, 20.0), "destination": ("road 1", -1, 100.0)}
    env = TownEnv({"vehicles_count": 0, **places}, map=str(small_map.write(tmp_path)))
    terminated, _, info = drive(env, 0)
    assert terminated
    assert info["arrived"]
    assert not info["route_end"]


def test_random_destinations_are_found_although_not_all_can_be_reached(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.crossing([150.0, 150.0, 150.0, 150.0])
    env = TownEnv({"vehicles_count": 0, "destination": "random"}, map=str(small_map.write(tmp_path)))
    for seed in range(40):
        env.reset(seed=seed)


def test_a_destination_that_not_every_start_leads_to_is_reached(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.crossing([150.0, 150.0, 150.0, 150.0])
    path = str(small_map.write(tmp_path))
    config = {"vehicles_count": 0, "destination": ("road 1", -1, 100.0)}
    env = TownEnv(config, map=path)
    for seed in range(20):
        env.reset(seed=seed)
    with pytest.raises(
        ValueError, match=r"^on the map small no way leads from lane -1 of road 0 to lane -1 of road 1$"
    ):
        TownEnv({**config, "start": ("road 0", -1, 20.0)}, map=path)


def test_a_route_stays_on_the_map_where_it_can(tmp_path: Path) -> None:
    """A ring of two lanes; the outer one leads off the map and comes in again."""
    small_map = SmallMap()
    bend = (40.0 * math.pi, 1.0 / 40.0)
    # Lane -1 goes round for ever, lane -2 ends at the map's edge where it comes from it.
    small_map.road(1, (0, 0, 0), [(200, 0), bend, (200, 0), bend], (-1,), (1, "end"), (1, "start"))
    small_map.road(2, (0, -3.5, 0), [(200, 0)], lanes=(-1,))
    town = small_map.load(tmp_path)
    assert town.graph.leaves.sum() == 1
    (away,) = np.flatnonzero(town.graph.leaves)
    ring_lane = int(np.flatnonzero(~town.graph.leaves)[0])
    for lane, ends in ((ring_lane, False), (int(away), True)):
        route = Route(town.graph, lane, 10.0, np.random.default_rng(0))
        for _ in range(300):
            x, y, _ = route.poses(np.array([route.position + 5.0]))[0]
            route.advance(x, y)
            if route.position >= route.end:
                break
        assert math.isfinite(route.end) == ends


@pytest.mark.parametrize("length", [14.0, 40.0])
def test_the_ego_starts_on_a_short_map(tmp_path: Path, length: float) -> None:
    small_map = SmallMap()
    small_map.road(1, (0, 0, 0), [(length, 0)])
    env = TownEnv({"vehicles_count": 0}, map=str(small_map.write(tmp_path)))
    terminated, truncated, info = drive(env, 0)
    assert truncated
    assert not terminated
    assert info["distance"] < length


def test_the_ego_starts_where_no_lane_is_as_long_as_two_cars(tmp_path: Path) -> None:
    small_map = SmallMap()
    end = small_map.road(1, (0, 0, 0), [(7.0, 0.02)], lanes=(-1,), after=(2, "start"))
    small_map.road(2, end, [(7.0, -0.02)], lanes=(-1,), before=(1, "end"))
    env = TownEnv({"vehicles_count": 0}, map=str(small_map.write(tmp_path)))
    for seed in range(3):
        assert drive(env, seed)[2]["route_end"]


def test_a_nearly_full_map_has_room_at_every_reset(tmp_path: Path) -> None:
    """The ego takes away one or two of the places; on some starts too many."""
    small_map = SmallMap()
    small_map.road(1, (0, 0, 0), [(200, 0)], lanes=(-1,))
    path = str(small_map.write(tmp_path))
    vector = TownVectorEnv(3, {"vehicles_count": starting_places(load_town(path)) - 1}, map=path)
    for seed in range(30):
        vector.reset(seed=seed)


def test_what_a_map_has_room_for_beside_an_ego_fits_at_every_reset(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.crossing([200.0, 150.0, 60.0, 90.0])
    path = str(small_map.write(tmp_path))
    town = load_town(path)
    room = places_beside_an_ego(town)
    assert starting_places(town) - 4 <= room < starting_places(town)
    vector = TownVectorEnv(8, {"vehicles_count": room}, map=path)
    for seed in range(0, 240, 8):
        vector.reset(seed=seed)


def test_gymnasiums_checker_finds_nothing_on_an_open_map(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.crossing([60.0, 60.0, 60.0, 60.0])
    env = gymnasium.make("athrl/OpenDrive-v0", map=str(small_map.write(tmp_path)), config=FEW)
    check_env(env.unwrapped, skip_render_check=True)


def test_a_vector_does_on_an_open_map_what_single_environments_do(tmp_path: Path) -> None:
    small_map = SmallMap()
    small_map.crossing([60.0, 80.0, 60.0, 40.0])
    path, config = str(small_map.write(tmp_path)), {"vehicles_count": 10, "episode_ticks": 200}
    vector = TownVectorEnv(5, config, map=path, threads=2, autoreset_mode="Disabled")
    alone = [TownEnv(config, map=path) for _ in range(5)]
    vector.reset(seed=7)
    for e, env in enumerate(alone):
        env.reset(seed=7 + e)
    action = np.tile(np.array([0.8, 0.0], np.float32), (5, 1))
    driving, ends = np.ones(5, np.bool_), 0
    for _ in range(60):
        rewards, terminated, truncated, infos = vector.step_environments(action, driving)
        for e in np.flatnonzero(driving).tolist():
            observation, reward, terminated_alone, truncated_alone, info = alone[e].step(action[e])
            np.testing.assert_array_equal(vector.images[e], observation["image"])
            assert (rewards[e], terminated[e], truncated[e]) == (reward, terminated_alone, truncated_alone)
            assert (infos["arrived"][e], infos["route_end"][e]) == (info["arrived"], info["route_end"])
            ends += info["route_end"]
        driving &= ~(terminated | truncated)
    assert ends
