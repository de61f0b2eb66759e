"""The environment follows the rules of gymnasium and of the task: decisions, endings, sums, seeds."""

import copy
import hashlib
import subprocess
import sys
import warnings
from collections.abc import Callable
from typing import Any

import athrl_driving  # noqa: F401  (registers the environment)
import gymnasium
import numpy as np
import pytest
from athrl_driving.drivers import RuleBasedDriver
from athrl_driving.envs import TownEnv
from athrl_driving.reward import REWARD_TERMS
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

STRAIGHT_SLOWLY = np.array([-0.5, 0.0], dtype=np.float32)
HARD_RIGHT = np.array([0.0, 1.0], dtype=np.float32)
HARD_LEFT = np.array([0.0, -1.0], dtype=np.float32)


def new_env(**config: object) -> TownEnv:
    return TownEnv(config={"vehicles_count": 20, **config})


def drive(env: TownEnv, action: NDArray[np.float32], decisions: int) -> list[tuple]:
    """Results of repeating an action until the episode ends."""
    results = []
    for _ in range(decisions):
        results.append(env.step(action))
        if results[-1][2] or results[-1][3]:
            break
    return results


def test_gymnasiums_checker_finds_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make("athrl/Town03-v0", render_mode="rgb_array").unwrapped)


def test_observation_is_what_the_contract_says() -> None:
    env = new_env(image_size=64)
    observation, _ = env.reset(seed=1)
    assert observation["image"].shape == (64, 64, 4)
    assert observation["image"].dtype == np.uint8
    assert observation["motion"].dtype == np.float32
    assert observation["motion"].tolist() == [0.0, 0.0]
    observation = env.step(np.array([1.0, 0.5], dtype=np.float32))[0]
    assert env.observation_space.contains(observation)
    expected = [env.vehicle.speed / 8.0, env.vehicle.steering / 0.3]
    np.testing.assert_allclose(observation["motion"], expected, rtol=1e-6)
    assert observation["motion"][1] > 0


def test_the_ego_starts_standing_on_its_lane_with_room_around_it() -> None:
    env = new_env(vehicles_count=100)
    places = set()
    for seed in range(10):
        env.reset(seed=seed)
        others = env.road.background
        assert env.vehicle.speed == 0.0
        assert env.route.lateral == 0.0
        assert others.x.size == 100
        assert np.hypot(others.x - env.vehicle.position[0], others.y - env.vehicle.position[1]).min() > 8.0
        places.add(tuple(env.vehicle.position))
    assert len(places) == 10


def test_a_decision_holds_for_four_ticks_and_is_counted_once() -> None:
    env = new_env(vehicles_count=0)
    env.reset(seed=2)
    for decision in range(1, 6):
        info = env.step(STRAIGHT_SLOWLY)[4]
        assert info["ticks"] == 4
        assert env.scene().step == decision
        assert env.scene().time == pytest.approx(0.4 * decision)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([np.nan, 0.0], r"the action is \[nan, 0.0\], it should be finite numbers"),
        ([0.0, np.inf], "it should be finite numbers"),
        ([0.0], r"the action has shape \(1,\), it should be \(2,\)"),
        ([[0.0, 0.0]], r"the action has shape \(1, 2\), it should be \(2,\)"),
        ("left", "the action is 'left', it should be float32"),
    ],
)
def test_an_invalid_action_is_refused_before_anything_moves(action: object, message: str) -> None:
    env, untouched = new_env(), new_env()
    env.reset(seed=3)
    untouched.reset(seed=3)
    with pytest.raises(ValueError, match=message):
        env.step(action)
    after, reward, *_ = env.step(STRAIGHT_SLOWLY)
    expected, expected_reward, *_ = untouched.step(STRAIGHT_SLOWLY)
    assert env.time == untouched.time
    assert reward == expected_reward
    np.testing.assert_array_equal(after["image"], expected["image"])
    np.testing.assert_array_equal(after["motion"], expected["motion"])


def test_an_action_beyond_the_bounds_is_the_bound() -> None:
    beyond, bound = new_env(), new_env()
    beyond.reset(seed=3)
    bound.reset(seed=3)
    for _ in range(5):
        motion = beyond.step(np.array([7.0, -9.0]))[0]["motion"]
        np.testing.assert_array_equal(motion, bound.step(np.array([1.0, -1.0]))[0]["motion"])


def test_rewards_of_the_ticks_are_summed() -> None:
    by_decision, by_tick = new_env(), new_env(ticks_per_decision=1)
    by_decision.reset(seed=3)
    by_tick.reset(seed=3)
    _, reward, _, _, info = by_decision.step(STRAIGHT_SLOWLY)
    # One decision per tick would set a new waypoint; give the ego the one that held for all four.
    waypoint, total = by_decision.vehicle.waypoint, dict.fromkeys(REWARD_TERMS, 0.0)
    by_tick.vehicle.follow(by_decision.vehicle.target_speed, waypoint)
    for _ in range(4):
        by_tick._simulate(None)
        for name, value in by_tick._rewards(STRAIGHT_SLOWLY).items():
            total[name] += value
    assert info["reward_terms"] == pytest.approx(total)
    assert reward == pytest.approx(sum(total.values()))
    assert tuple(info["reward_terms"]) == REWARD_TERMS


def test_the_waypoint_stays_in_the_world_between_decisions() -> None:
    env = new_env(vehicles_count=0)
    env.reset(seed=4)
    x, y, heading = *env.vehicle.position, env.vehicle.heading
    env.step(np.array([1.0, 0.5], dtype=np.float32))
    angle = heading + 0.5 * np.pi / 6
    expected = (x + 8.0 * np.cos(angle), y + 8.0 * np.sin(angle))
    np.testing.assert_allclose(env.scene().waypoint, expected)
    assert env.scene().target_speed == pytest.approx(7.95)


@pytest.mark.parametrize(("action", "side"), [(HARD_RIGHT, 1), (HARD_LEFT, -1)])
def test_both_sides_can_be_steered_to(action: NDArray[np.float32], side: int) -> None:
    env = new_env(vehicles_count=0)
    for seed in range(5):
        env.reset(seed=seed)
        heading = env.vehicle.heading
        result = drive(env, action, 30)[-1]
        assert side * (env.vehicle.heading - heading) > 0
        assert side * env.route.lateral > 2.0  # the driver's right is positive
        assert result[4]["off_lane"]
        assert result[2]
        assert not result[3]


def test_the_episode_ends_at_the_very_tick_the_lane_is_left() -> None:
    env = new_env(vehicles_count=0)
    shortened = 0
    for seed in range(12):
        env.reset(seed=seed)
        *_, info = drive(env, HARD_RIGHT, 40)[-1]
        assert info["reward_terms"]["out"] == -1.0
        shortened += info["ticks"] < 4
    assert shortened > 0


def test_a_collision_ends_the_episode_and_costs_two_hundred_once() -> None:
    env = new_env(vehicles_count=0)
    env.reset(seed=7)
    obstacle = env.vehicle.create_from(env.vehicle)
    obstacle.position = env.vehicle.position + 9.0 * env.vehicle.direction
    env.road.objects.append(obstacle)
    results = drive(env, np.array([1.0, 0.0], dtype=np.float32), 30)
    _, _, terminated, truncated, info = results[-1]
    assert terminated
    assert not truncated
    assert info["collision"]
    assert sum(result[4]["reward_terms"]["collision"] for result in results) == -200.0


def test_the_time_limit_truncates_and_does_not_terminate() -> None:
    env = new_env(vehicles_count=0, episode_ticks=10)
    env.reset(seed=8)
    results = drive(env, STRAIGHT_SLOWLY, 10)
    assert [result[2:4] for result in results] == [(False, False), (False, False), (False, True)]
    assert [result[4]["ticks"] for result in results] == [4, 4, 2]


def test_the_controllers_remember_from_tick_to_tick_and_from_decision_to_decision() -> None:
    env = new_env(vehicles_count=0)
    env.reset(seed=9)
    controller = env.vehicle.controller
    sums = []
    for _ in range(20):
        env.step(np.array([-0.2, 0.02], dtype=np.float32))
        assert env.vehicle.controller is controller
        sums.append((controller.speed_loop.error_sum, controller.steering_loop.error_sum))
        assert controller.speed_loop.last_error is not None
    assert len(set(sums)) > 15
    env.reset(seed=9)
    assert env.vehicle.controller.speed_loop.error_sum == 0.0
    assert env.vehicle.controller.speed_loop.last_error is None


def test_the_target_speed_is_reached_in_the_same_unit() -> None:
    env = new_env(vehicles_count=0)
    env.reset(seed=10)
    driver = RuleBasedDriver()
    for _ in range(40):
        action = driver.act(env)
        action[0] = 2.0 * 5.0 / 7.95 - 1.0
        info = env.step(action)[4]
    assert info["speed"] == pytest.approx(5.0, abs=0.05)
    assert env.vehicle.speed == pytest.approx(5.0, abs=0.05)


def test_distance_is_what_was_driven() -> None:
    env = new_env(vehicles_count=0)
    env.reset(seed=11)
    driver, driven, place = RuleBasedDriver(), 0.0, env.vehicle.position.copy()
    for _ in range(50):
        info = env.step(driver.act(env))[4]
        driven += float(np.linalg.norm(env.vehicle.position - place))
        place = env.vehicle.position.copy()
    assert info["distance"] == pytest.approx(driven, rel=0.02)


def fingerprint() -> str:
    """Hash of all results of two episodes."""
    env, rng, digest = TownEnv(), np.random.default_rng(0), hashlib.sha256()
    for seed in (5, 6):
        env.reset(seed=seed)
        for _ in range(40):
            observation, reward, *ended, info = env.step(rng.uniform(-0.1, 0.1, 2).astype(np.float32))
            digest.update(observation["image"].tobytes() + observation["motion"].tobytes())
            digest.update(repr((reward, info)).encode() + env.vehicle.position.tobytes())
            digest.update(env.road.background.x.tobytes())
            if any(ended):
                break
    return digest.hexdigest()


def test_a_seed_makes_the_same_episode_in_another_process() -> None:
    result = subprocess.run(
        [sys.executable, __file__], capture_output=True, text=True, check=True, timeout=200
    )
    assert result.stdout.strip() == fingerprint()


def test_seeds_differ_and_the_route_does_not_depend_on_the_traffic() -> None:
    busy, empty = new_env(vehicles_count=60), new_env(vehicles_count=0)
    lanes = []
    for seed in range(5):
        busy.reset(seed=seed)
        empty.reset(seed=seed)
        np.testing.assert_array_equal(busy.route.lanes, empty.route.lanes)
        np.testing.assert_array_equal(busy.vehicle.position, empty.vehicle.position)
        lanes.append(tuple(busy.route.lanes))
    assert len(set(lanes)) > 3


def test_a_copy_is_independent_of_the_original() -> None:
    env, expected = new_env(), new_env()
    for each in (env, expected):
        each.reset(seed=12)
        each.step(STRAIGHT_SLOWLY)
    copied = copy.deepcopy(env)
    drive(copied, HARD_RIGHT, 3)
    assert copied.vehicle.heading > env.vehicle.heading
    copied = copy.deepcopy(env)
    for _ in range(5):
        results = [each.step(STRAIGHT_SLOWLY) for each in (env, copied, expected)]
        for one, *others in zip(*results, strict=True):
            assert all(repr(one) == repr(other) for other in others)


def test_spaces_and_their_seeds_last_over_resets() -> None:
    env = new_env(vehicles_count=0)
    space = env.action_space
    env.reset(seed=1)
    assert env.action_space is space
    env.reset(options={"config": {"image_size": 64}})
    assert env.observation_space["image"].shape == (64, 64, 4)


def test_scene_shows_all_vehicles() -> None:
    env = new_env(vehicles_count=30)
    env.reset(seed=13)
    env.step(STRAIGHT_SLOWLY)
    scene = env.scene()
    assert len(scene.vehicles) == 30
    assert scene.route.shape == (12, 2)
    assert (scene.ego.length, scene.ego.width) == (4.9, 2.1)
    assert scene.reward == pytest.approx(sum(scene.reward_terms.values()))
    assert scene.vehicles[3].x == env.road.background.x[3]


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"vehicle_count": 5}, "no setting 'vehicle_count', did you mean 'vehicles_count'"),
        ({"image_size": 0}, "image_size is 0, it should be a whole number from 8 to 512"),
        ({"waypoint_half_angle": "wide"}, "waypoint_half_angle is 'wide', it should be a number"),
        ({"town": "atlantis"}, "no town named 'atlantis'. There are town02, town03, town04"),
        ({"town": "Town3"}, "no town named 'Town3', did you mean 'town03'?"),
        ({"town": 3}, "town is 3, it should be one of town02, town03, town04, random-1 to "),
        ({"window_side": "wide"}, "window_side is 'wide', it should be a number from 4 to 1000"),
        ({"lidar_rays": 7.5}, "lidar_rays is 7.5, it should be a whole number from 4 to 7200"),
        ({"lidar_range": float("nan")}, "lidar_range is nan, it should be a number"),
        (
            {"ego_above_lower_edge": 40},
            "ego_above_lower_edge is 40, it should be from 0 to the window",
        ),
        ({"screen_width": -1}, "screen_width is -1, it should be a whole number from 16 to 10000"),
        ({"scaling": 0}, "scaling is 0, it should be a number from 0.1 to 1000"),
        ({"centering_position": [0.5]}, "centering_position is [0.5], it should be two numbers from 0 to 1"),
        ({"show_trajectories": "no"}, "show_trajectories is 'no', it should be False or True"),
        ({"offscreen_rendering": 0}, "offscreen_rendering is 0, it should be None, False or True"),
        ({"observation": {"type": "Kinematics"}}, "it should be {'type': 'BirdEyeObservation'}"),
        ({"action": {"type": "DiscreteMetaAction"}}, "it should be {'type': 'WaypointAction'}"),
        (
            {"other_vehicles_type": "highway_env.vehicle.behavior.LinearVehicle"},
            "it should stay 'highway",
        ),
        ({"manual_control": True}, "manual_control is True, it should stay False"),
        ({"neighbour_vehicles_connected_lanes": True}, "it should stay False: a town's vehicles see"),
        (
            {"policy_frequency": 1},
            "policy_frequency is 1, it should be 2.5: simulation_frequency / ticks",
        ),
        ({"start": ("Circle Road South", "1", 5.0)}, "it should be None or (road name, lane id, metres"),
        ({"traffic_near": (0, 0)}, "it should be None or (x, y, radius) in metres"),
        ({7: 1}, "the environment has no setting 7"),
    ],
)
def test_a_wrong_setting_is_refused_in_one_line(setting: dict, message: str) -> None:
    with pytest.raises(ValueError, match=r"(?s).+") as error:
        TownEnv(config=setting)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_a_setting_given_as_an_argument_is_told_where_it_belongs(make: Callable[..., Any]) -> None:
    with pytest.raises(TypeError, match=r"no argument 'vehicles_count'; .* config=\{'vehicles_count': 3\}"):
        make("athrl/Town03-v0", vehicles_count=3)


class NoValue:
    """A value that no setting accepts."""


@pytest.mark.parametrize("key", sorted(TownEnv.default_config()))
def test_no_setting_is_taken_and_ignored(key: str) -> None:
    with pytest.raises(ValueError, match=rf"the setting {key} is <.*NoValue object at .*>, it should"):
        TownEnv(config={key: NoValue()})


def test_the_settings_of_an_environment_make_another_one_like_it() -> None:
    env = new_env(ticks_per_decision=2, simulation_frequency=20)
    other = TownEnv(config=env.config)
    assert other.config == env.config
    assert other.config["policy_frequency"] == 10
    assert TownEnv(config={"vehicles_count": np.int64(3)}).config["vehicles_count"] == 3


def test_an_unknown_town_leaves_the_environment_as_it_was() -> None:
    env = new_env()
    env.reset(seed=1)
    with pytest.raises(ValueError, match="atlantis"):
        env.reset(options={"config": {"town": "atlantis"}})
    assert env.config["town"] == "town03"
    env.reset(seed=1)


@pytest.mark.parametrize("show_trajectories", [False, True])
def test_the_renderer_of_highway_env_draws_the_town(show_trajectories: bool) -> None:
    settings = {"vehicles_count": 20, "show_trajectories": show_trajectories}
    env = TownEnv(config=settings, render_mode="rgb_array")
    env.reset(seed=14)
    drive(env, STRAIGHT_SLOWLY, 5)
    frame = env.render()
    env.close()
    assert frame.shape == (600, 600, 3)
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 3


if __name__ == "__main__":
    print(fingerprint())
