"""A batch of environments drives each of them as if it were alone."""

import gymnasium
import numpy as np
import pytest
from athrl_driving.envs import TownEnv
from athrl_driving.envs.settings import changed_settings
from athrl_driving.policy import EnvironmentBatch, config_of, environment_config
from athrl_spaces import (
    WAYPOINT_SET,
    LevelDescription,
    Limits,
    Observation,
    PolicyDescription,
    action_kind,
)
from athrl_spaces.environment import BOUNDS

CONFIG = environment_config(
    strict_map=False,
    vehicles=10,
    image_size=32,
    episode_ticks=20,
    ticks_per_decision=4,
    maximum_speed=7.95,
    waypoint_radius=8.0,
    waypoint_half_angle=30.0,
    speed_gain=0.7,
)


def test_environments_show_what_each_environment_alone_would_show():
    batch = EnvironmentBatch(["town03"] * 2, CONFIG)
    for env_index, seed in enumerate((5, 6)):
        batch.reset(env_index, seed)
    action = np.array([0.5, 0.0], np.float32)
    steps = [batch.step(np.stack([action, action])) for _ in range(3)]
    alone = gymnasium.make("athrl/Town03-v0", config=CONFIG)
    alone.reset(seed=6)
    for step in steps:
        observation, reward, terminated, truncated, _ = alone.step(action)
        assert step.rewards[1] == np.float32(reward)
        assert (step.terminated[1], step.truncated[1]) == (terminated, truncated)
    np.testing.assert_array_equal(batch.images[1], observation["image"])
    np.testing.assert_array_equal(batch.motion[1], observation["motion"])


def test_environments_that_are_not_active_stand_still():
    batch = EnvironmentBatch(["town03"] * 2, CONFIG)
    batch.reset(0, 1)
    batch.reset(1, 2)
    before = batch.images[1].copy()
    step = batch.step(np.ones((2, 2), np.float32), active=np.array([True, False]))
    assert step.infos["ticks"].tolist() == [4, 0]
    assert step.infos["_ticks"].tolist() == [True, False]
    np.testing.assert_array_equal(batch.images[1], before)


def test_the_configs_angle_is_in_radians():
    assert CONFIG["waypoint_half_angle"] == pytest.approx(np.pi / 6)


def test_an_unknown_town_is_named():
    with pytest.raises(ValueError, match="atlantis"):
        EnvironmentBatch(["atlantis"], CONFIG)


def test_a_policys_description_makes_an_environment_that_takes_its_decisions():
    limits = Limits(6.0, 5.0, 0.4)
    levels = tuple(
        LevelDescription(action.name, (action,)) for action in action_kind(WAYPOINT_SET).describe(limits)
    )
    description = PolicyDescription("test", WAYPOINT_SET, limits, Observation(64), levels)
    env = gymnasium.make("athrl/Town03-v0", config={"vehicles_count": 0, **config_of(description)})
    observation, _ = env.reset(seed=1)
    assert observation["image"].shape == description.observation.image_shape
    assert observation["motion"].shape == (description.observation.motion_size,)
    decided = {"behaviour": np.array([[2]], np.float32), "waypoint": np.array([[15]], np.float32)}
    place, heading = env.unwrapped.vehicle.position.copy(), env.unwrapped.vehicle.heading
    env.step(description.environment_action(decided)[0])
    assert env.unwrapped.vehicle.target_speed == pytest.approx(6.0)
    to_waypoint = 5.0 * np.array([np.cos(heading + 0.4), np.sin(heading + 0.4)])
    np.testing.assert_allclose(env.unwrapped.vehicle.waypoint, place + to_waypoint)


@pytest.mark.parametrize("name", BOUNDS)
def test_bounds_of_settings_are_those_that_run_files_share(name: str):
    kind, low, high = BOUNDS[name]
    plain = {
        "strict_map": False, "vehicles": 10, "image_size": 32, "episode_ticks": 20, "ticks_per_decision": 4,
        "maximum_speed": 7.95, "waypoint_radius": 8.0, "waypoint_half_angle": 30.0,
        "speed_gain": 0.7,
    }  # fmt: skip
    defaults = TownEnv.default_config()
    for value in (low, high):
        changed_settings(defaults, environment_config(**{**plain, name: kind(value)}), None)
    step = 1 if kind is int else 1e-3
    for value in (low - step, high + step):
        with pytest.raises(ValueError, match="it should be"):
            changed_settings(defaults, environment_config(**{**plain, name: value}), None)
