"""Shares of towns become environments, and several towns in one batch do what each of them does alone."""

import math

import numpy as np
import pytest
from athrl_driving.envs import TownEnv
from athrl_driving.episode.drive import drive
from athrl_driving.policy import EnvironmentBatch, GuardedBatch, spread_towns
from athrl_spaces import REWARD_TERMS
from hypothesis import given
from hypothesis import strategies as st

CONFIG = {"vehicles_count": 10, "episode_ticks": 20}
MIXED = ["town03", "town02", "town03", "town04", "town02", "town03"]

SHARES = st.dictionaries(
    st.sampled_from(["town02", "town03", "town04", "other.xodr"]), st.floats(0, 100), min_size=1
).filter(lambda shares: sum(shares.values()) > 1e-3)


@given(SHARES, st.integers(0, 200))
def test_every_environment_has_a_town_and_each_town_its_share(shares: dict[str, float], count: int) -> None:
    towns = spread_towns(shares, count)
    assert len(towns) == count
    wanted = {town: share / sum(shares.values()) for town, share in shares.items() if share > 0}
    assert set(towns) <= set(wanted)
    if count >= len(wanted):
        assert set(towns) == set(wanted)
    for town, share in wanted.items():
        # A town that would have none takes one from a larger one.
        assert towns.count(town) <= max(1, math.ceil(share * count))
        assert towns.count(town) >= math.floor(share * count) - len(wanted)


@pytest.mark.parametrize(
    ("shares", "count", "expected"),
    [
        ({"town03": 1.0}, 3, {"town03": 3}),
        ({"town03": 2, "town04": 1}, 64, {"town03": 43, "town04": 21}),
        ({"town03": 1, "town04": 1, "town02": 1}, 64, {"town03": 22, "town04": 21, "town02": 21}),
        ({"town03": 99, "town04": 1}, 8, {"town03": 7, "town04": 1}),
        ({"town03": 1, "town04": 0}, 4, {"town03": 4}),
        ({"town03": 1, "town04": 3}, 1, {"town04": 1}),
    ],
)
def test_shares_are_rounded_by_the_largest_remainder(
    shares: dict[str, float], count: int, expected: dict[str, int]
) -> None:
    towns = spread_towns(shares, count)
    assert {town: towns.count(town) for town in set(towns)} == expected


def test_towns_are_interleaved() -> None:
    assert spread_towns({"a": 1, "b": 1}, 6) == ["a", "b", "a", "b", "a", "b"]
    assert spread_towns({"a": 3, "b": 1}, 8) == ["a", "a", "b", "a", "a", "a", "b", "a"]


@pytest.mark.parametrize(
    ("shares", "count", "message"),
    [
        ({"town03": -1.0}, 4, "the share of town03 is -1.0; it should be a finite number, 0 or more"),
        ({"town03": math.nan}, 4, "the share of town03 is nan"),
        ({"town03": math.inf}, 4, "the share of town03 is inf"),
        ({"town03": 0.0}, 4, "no town has a share"),
        ({}, 4, "no town has a share"),
        ({"town03": 1.0}, -1, "the number of environments is -1"),
    ],
)
def test_invalid_shares_are_refused(shares: dict, count: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        spread_towns(shares, count)


@pytest.mark.parametrize("kind", [EnvironmentBatch, GuardedBatch])
@pytest.mark.parametrize("action_kind", ["waypoint", "waypoint-set", "direct"])
def test_towns_in_one_batch_do_what_each_does_alone(kind: type, action_kind: str) -> None:
    more = {"seconds": 60} if kind is GuardedBatch else {}
    batch = kind(MIXED, CONFIG, action_kind, recorded=6, **more)
    action_type = dict(
        zip(["waypoint", "waypoint-set", "direct"], ["Waypoint", "WaypointSet", "Direct"], strict=True)
    )
    alone = [
        TownEnv(config={**CONFIG, "town": town, "action": {"type": f"{action_type[action_kind]}Action"}})
        for town in MIXED
    ]
    seen: list[list[dict]] = []
    earned: list[list[list[float]]] = [[] for _ in MIXED]
    for env_index, env in enumerate(alone):
        batch.reset(env_index, seed=40 + env_index)
        seen.append([env.reset(seed=40 + env_index)[0]])
    rng, running = np.random.default_rng(3), np.ones(len(MIXED), bool)
    for _ in range(5):
        actions = np.array([env.action_space.sample() for env in alone], np.float32)
        actions[:, 1] = rng.uniform(-1, 1, len(MIXED)) if action_kind != "waypoint-set" else actions[:, 1]
        step = batch.step(actions, active=running)
        for env_index in np.flatnonzero(running).tolist():
            observation, reward, terminated, truncated, info = alone[env_index].step(actions[env_index])
            seen[env_index].append(observation)
            np.testing.assert_array_equal(batch.images[env_index], observation["image"])
            np.testing.assert_array_equal(batch.motion[env_index], observation["motion"])
            assert step.rewards[env_index] == np.float32(reward)
            assert (step.terminated[env_index], step.truncated[env_index]) == (terminated, truncated)
            assert step.infos["distance"][env_index] == info["distance"]
            assert step.infos["reward_terms"]["speed"][env_index] == info["reward_terms"]["speed"]
            assert batch.info(env_index) == info
            earned[env_index].append([info["reward_terms"][term] for term in REWARD_TERMS])
            assert batch.environments[env_index].town is alone[env_index].town
            if terminated or truncated:
                assert step.infos["metrics"]["distance"][env_index] == info["metrics"]["distance"]
                running[env_index] = False
    for env_index, observations in enumerate(seen):
        for place, observation in enumerate(observations):
            np.testing.assert_array_equal(batch.recording.images[env_index, place], observation["image"])
            np.testing.assert_array_equal(batch.recording.motion[env_index, place], observation["motion"])
        terms = batch.recording.terms[env_index, 1 : len(observations)]
        np.testing.assert_array_equal(terms, np.array(earned[env_index], np.float32))
    batch.close()


def test_environments_that_are_not_active_stand_still_in_every_town() -> None:
    batch = EnvironmentBatch(MIXED, CONFIG)
    for env_index in range(len(batch)):
        batch.reset(env_index, seed=env_index)
    before = batch.images.copy()
    active = np.array([True, False, False, False, True, True])
    step = batch.step(np.ones((6, 2), np.float32), active)
    assert step.infos["ticks"].tolist() == [4, 0, 0, 0, 4, 4]
    assert step.infos["_ticks"].tolist() == active.tolist()
    np.testing.assert_array_equal(batch.images[~active], before[~active])
    batch.close()


def test_an_invalid_action_moves_no_town() -> None:
    batch = EnvironmentBatch(["town02", "town03"], CONFIG)
    for env_index in range(2):
        batch.reset(env_index, seed=env_index)
    with pytest.raises(ValueError, match=r"of environments \[1\] is \[0.0, nan\]"):
        batch.step(np.array([[0, 0], [0, np.nan]], np.float32))
    assert [environment.scene().step for environment in batch.environments] == [0, 0]
    batch.close()


def test_ranks_are_even_within_each_town() -> None:
    batch = EnvironmentBatch(MIXED, CONFIG)
    guarded = GuardedBatch(MIXED, CONFIG, seconds=60)
    for each in (batch, guarded):
        assert each.towns == MIXED
        assert each.action_kind == "waypoint"
        np.testing.assert_array_equal(each.ranks, [0.0, 0.0, 0.5, 0.5, 1.0, 1.0])
        each.close()


def test_another_town_compiles_nothing_again() -> None:
    def compiled() -> int:
        return len(drive.overloads)

    EnvironmentBatch(["town03"], CONFIG).close()
    EnvironmentBatch(["town03", "town02"], CONFIG, recorded=3).close()
    before = compiled()
    batch = EnvironmentBatch(["town02", "town04"] * 5, CONFIG, "direct", recorded=7)
    batch.reset(0, 1)
    batch.step(np.zeros((10, 2), np.float32), active=np.arange(10) == 0)
    assert compiled() == before == 1
    batch.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((["town03", "atlantis"], CONFIG), "no town named 'atlantis'"),
        ((["town03"], CONFIG, "waypoints"), "there is no kind of action 'waypoints'; there are waypoint, "),
        (("town03", CONFIG), "the towns are 'town03'; there should be one for each environment"),
        (([], CONFIG), r"the towns are \[\]; there should be"),
        ((["town03"], {"image_sise": 32}), "did you mean 'image_size'"),
    ],
)
def test_a_batch_that_cannot_be_is_refused_in_one_line(arguments: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        EnvironmentBatch(*arguments)
    assert "\n" not in str(error.value)
