"""Exploration: physical units, a memory per environment, by rank, and what the description asks for."""

import numpy as np
import pytest
from athrl_driving.policy import ExplorationNoise
from athrl_spaces import (
    WAYPOINT,
    WAYPOINT_SET,
    Continuous,
    Discrete,
    Epsilon,
    LevelDescription,
    Limits,
    Noise,
    Observation,
    PolicyDescription,
    Sampled,
    ranks,
)

OU = Noise(0.2, 0.2, 0.15)
WHITE = Noise(0.1, 0.1, 1.0)
NAN = np.float32(np.nan)


def description(speed: Noise | Sampled = OU, angle: Noise | Sampled = WHITE) -> PolicyDescription:
    actions = (
        Continuous("target_speed", "m/s", 0.0, 8.0, speed),
        Continuous("waypoint_angle", "rad", -0.5, 0.5, angle, sideways=True),
    )
    levels = (LevelDescription("trajectory", actions, 2),)
    return PolicyDescription("test", WAYPOINT, Limits(), Observation(8), levels)


def choices(epsilon: Epsilon) -> PolicyDescription:
    behaviour = Discrete("behaviour", ("stop", "slow", "drive"), epsilon)
    waypoint = Discrete("waypoint", tuple(str(number) for number in range(16)), epsilon)
    levels = (LevelDescription("behaviour", (behaviour,)), LevelDescription("waypoint", (waypoint,)))
    return PolicyDescription("test", WAYPOINT_SET, Limits(), Observation(8), levels)


def explorer(described: PolicyDescription, batch: int, seed: int = 1) -> ExplorationNoise:
    return ExplorationNoise(described, ranks(batch), np.random.default_rng(seed))


def draws(noise: ExplorationNoise, count: int) -> np.ndarray:
    return np.array([noise.draw().noise["trajectory"] for _ in range(count)])  # [count, batch, 2]


def test_noise_is_scaled_to_the_range_of_each_action():
    values = draws(explorer(description(), 256), 200)[100:]
    stationary = 0.2 / np.sqrt(1 - 0.85**2)  # half-ranges
    assert values[..., 0].std() == pytest.approx(4.0 * stationary, rel=0.05)
    assert values[..., 1].std() == pytest.approx(0.5 * 0.1, rel=0.05)
    assert abs(values.mean(axis=(0, 1))).max() < 0.1


def test_damped_noise_remembers_and_white_noise_does_not():
    values = draws(explorer(description(), 256), 100)[50:]
    for action, correlation in ((0, 0.85), (1, 0.0)):
        before, after = values[:-1, :, action].ravel(), values[1:, :, action].ravel()
        assert np.corrcoef(before, after)[0, 1] == pytest.approx(correlation, abs=0.04)


def test_noise_rises_with_the_rank_of_an_environment():
    values = draws(explorer(description(angle=Noise(0.1, 0.5, 1.0)), 5), 4000)[..., 1]
    np.testing.assert_allclose(values.std(axis=0), 0.5 * np.array([0.1, 0.2, 0.3, 0.4, 0.5]), rtol=0.06)


def test_a_sampled_action_gets_a_standard_normal_number_that_nothing_remembers():
    values = draws(explorer(description(angle=Sampled()), 256), 100)
    assert values[..., 1].std() == pytest.approx(1.0, rel=0.03)
    before, after = values[:-1, :, 1].ravel(), values[1:, :, 1].ravel()
    assert np.corrcoef(before, after)[0, 1] == pytest.approx(0.0, abs=0.04)
    whole, half = (explorer(description(angle=Sampled()), 4, seed=7).draw(scale) for scale in (1.0, 0.5))
    np.testing.assert_allclose(0.5 * whole.noise["trajectory"], half.noise["trajectory"], rtol=1e-6)


def test_an_episodes_start_forgets_the_noise_of_its_environment_only():
    quiet = Noise(1e-9, 1e-9, 0.15)
    noise = explorer(description(speed=quiet), 2)
    state = noise.state()
    state["memory"]["trajectory"][:] = 1.0
    noise.load_state(state)
    noise.reset(0)
    first, second = noise.draw().noise["trajectory"][:, 0]
    assert abs(first) < 1e-6
    assert second == pytest.approx(0.85 * 4.0, rel=1e-5)


def test_the_runs_scale_multiplies_the_noise():
    loud, soft = (explorer(description(), 4, seed=7) for _ in range(2))
    np.testing.assert_allclose(
        0.5 * loud.draw().noise["trajectory"], soft.draw(0.5).noise["trajectory"], rtol=1e-6
    )
    assert not soft.draw(0.0).noise["trajectory"].any()


def test_uniform_decisions_fill_their_ranges():
    drawn = explorer(description(), 1000, seed=3).uniform()
    assert not drawn.noise
    values = drawn.forced["trajectory"]
    assert values.dtype == np.float32
    np.testing.assert_allclose(values.min(0), [0, -0.5], atol=0.05)
    np.testing.assert_allclose(values.max(0), [8, 0.5], atol=0.05)
    np.testing.assert_allclose(values.mean(0), [4, 0], atol=0.3)


def test_uniform_choices_are_each_as_frequent():
    drawn = explorer(choices(Epsilon(0.0, 0.0)), 16_000).uniform()
    for level, count in (("behaviour", 3), ("waypoint", 16)):
        found, times = np.unique(drawn.forced[level], return_counts=True)
        np.testing.assert_array_equal(found, np.arange(count))
        np.testing.assert_allclose(times, 16_000 / count, rtol=0.15)


def test_choices_are_random_with_a_probability_that_rises_with_the_rank():
    noise = explorer(choices(Epsilon(0.1, 0.5)), 5)
    drawn = [noise.draw() for _ in range(5000)]
    assert not any(each.noise for each in drawn)
    forced = np.array([each.forced["waypoint"][:, 0] for each in drawn])
    assert forced.dtype == np.float32
    np.testing.assert_allclose(np.isfinite(forced).mean(axis=0), [0.1, 0.2, 0.3, 0.4, 0.5], rtol=0.15)
    np.testing.assert_array_equal(np.unique(forced[np.isfinite(forced)]), np.arange(16))
    assert np.isnan(noise.draw(0.0).forced["behaviour"]).all()


def test_levels_are_explored_independently():
    noise = explorer(choices(Epsilon(0.5, 0.5)), 20_000)
    drawn = noise.draw().forced
    both = np.isfinite(drawn["behaviour"]) & np.isfinite(drawn["waypoint"])
    assert both.mean() == pytest.approx(0.25, abs=0.02)


def test_a_level_of_both_kinds_has_noise_for_one_and_choices_for_the_other():
    actions = (
        Continuous("target_speed", "m/s", -8.0, -2.0, WHITE),
        Discrete("gear", ("low", "high"), Epsilon(1.0, 1.0)),
        Continuous("waypoint_angle", "rad", -0.5, 0.5, WHITE),
    )
    described = PolicyDescription(
        "test", WAYPOINT, Limits(), Observation(8), (LevelDescription("all", actions),)
    )
    noise = explorer(described, 100)
    drawn = noise.draw()
    assert drawn.noise["all"][:, [0, 2]].all()
    assert not drawn.noise["all"][:, 1].any()
    assert np.isnan(drawn.forced["all"][:, [0, 2]]).all()
    assert set(drawn.forced["all"][:, 1]) == {0.0, 1.0}
    uniform = noise.uniform().forced["all"]
    assert (uniform[:, 0] <= -2.0).all()
    assert (uniform[:, 0] >= -8.0).all()
    assert set(uniform[:, 1]) == {0.0, 1.0}


@pytest.mark.parametrize("described", [description(), choices(Epsilon(0.3, 0.6))])
def test_its_state_continues_where_it_was(described: PolicyDescription):
    noise, other = explorer(described, 6), explorer(described, 6, seed=99)
    for _ in range(5):
        noise.draw()
    other.load_state(noise.state())
    for _ in range(5):
        one, same = noise.draw(0.7), other.draw(0.7)
        for name in one.noise | one.forced:
            np.testing.assert_array_equal(one.noise.get(name, NAN), same.noise.get(name, NAN))
            np.testing.assert_array_equal(one.forced.get(name, NAN), same.forced.get(name, NAN))
        np.testing.assert_array_equal(*(each.uniform().forced[name] for each in (noise, other)))


def test_a_state_of_another_size_is_refused():
    with pytest.raises(ValueError, match="broadcast"):
        explorer(description(), 6).load_state(explorer(description(), 4).state())
