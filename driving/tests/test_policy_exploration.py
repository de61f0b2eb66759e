"""Exploration noise: physical units, a memory per environment, what the metadata asks for."""

import numpy as np
import pytest
from athrl_driving.policy import ActionMetadata, ExplorationNoise, LevelMetadata, PolicyMetadata

OU = {"noise": "ornstein-uhlenbeck", "noise_scale": 0.2, "damping": 0.15}
GAUSSIAN = {"noise": "gaussian", "noise_scale": 0.1, "damping": 0.0}


def metadata(speed: dict = OU, angle: dict = GAUSSIAN) -> PolicyMetadata:
    actions = (
        ActionMetadata(name="target_speed", unit="m/s", low=0, high=8, **speed),
        ActionMetadata(name="waypoint_angle", unit="rad", low=-0.5, high=0.5, **angle),
    )
    level = LevelMetadata(name="trajectory", state_size=2, actions=actions)
    return PolicyMetadata(planner="test", image_shape=(8, 8, 4), motion=("speed",), levels=(level,))


def draws(noise: ExplorationNoise, count: int) -> np.ndarray:
    return np.array([noise.draw()["trajectory"] for _ in range(count)])  # [count, batch, 2]


def test_noise_is_scaled_to_the_range_of_each_action():
    values = draws(ExplorationNoise(metadata(), 256, np.random.default_rng(1)), 200)[100:]
    stationary = 0.2 / np.sqrt(1 - 0.85**2)  # half-ranges
    assert values[..., 0].std() == pytest.approx(4.0 * stationary, rel=0.05)
    assert values[..., 1].std() == pytest.approx(0.5 * 0.1, rel=0.05)
    assert abs(values.mean(axis=(0, 1))).max() < 0.1


def test_ornstein_uhlenbeck_remembers_and_gaussian_does_not():
    values = draws(ExplorationNoise(metadata(), 256, np.random.default_rng(1)), 100)[50:]
    for action, correlation in ((0, 0.85), (1, 0.0)):
        before, after = values[:-1, :, action].ravel(), values[1:, :, action].ravel()
        assert np.corrcoef(before, after)[0, 1] == pytest.approx(correlation, abs=0.04)


def test_an_episodes_start_forgets_the_noise_of_its_environment_only():
    quiet = {"noise": "ornstein-uhlenbeck", "noise_scale": 1e-9, "damping": 0.15}
    noise = ExplorationNoise(metadata(speed=quiet), 2, np.random.default_rng(1))
    noise._levels[0].memory[:] = 1.0
    noise.reset(0)
    first, second = noise.draw()["trajectory"][:, 0]
    assert abs(first) < 1e-6
    assert second == pytest.approx(0.85 * 4.0, rel=1e-5)


def test_the_runs_scale_multiplies_the_noise():
    loud, soft = (ExplorationNoise(metadata(), 4, np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_allclose(0.5 * loud.draw()["trajectory"], soft.draw(0.5)["trajectory"], rtol=1e-6)
    assert not soft.draw(0.0)["trajectory"].any()


def test_uniform_actions_fill_their_ranges():
    noise = ExplorationNoise(metadata(), 1000, np.random.default_rng(3))
    values = noise.uniform()["trajectory"]
    assert values.dtype == np.float32
    np.testing.assert_allclose(values.min(0), [0, -0.5], atol=0.05)
    np.testing.assert_allclose(values.max(0), [8, 0.5], atol=0.05)
    np.testing.assert_allclose(values.mean(0), [4, 0], atol=0.3)
