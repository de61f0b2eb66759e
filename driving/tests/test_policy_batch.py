"""A batch of environments drives each of them as it would be driven alone."""

import gymnasium
import numpy as np
import pytest
from athrl_driving.policy import EnvironmentBatch, environment_config

CONFIG = environment_config(
    vehicles=10,
    image_size=32,
    episode_ticks=20,
    ticks_per_decision=4,
    maximum_speed=7.95,
    waypoint_radius=8.0,
    waypoint_half_angle=30.0,
)


def test_rows_are_what_each_environment_alone_would_show():
    batch = EnvironmentBatch("town03", CONFIG, 2)
    for row, seed in enumerate((5, 6)):
        batch.reset(row, seed)
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


def test_rows_that_are_not_active_stand_still():
    batch = EnvironmentBatch("town03", CONFIG, 2)
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
        EnvironmentBatch("atlantis", CONFIG, 1)
