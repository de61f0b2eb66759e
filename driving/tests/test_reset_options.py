"""`reset(options=...)` changes settings, alike in one environment, in gymnasium's vectors and in our own."""

import copy
import pickle
import re
from collections.abc import Callable

import athrl_driving  # noqa: F401  (registers the environments)
import gymnasium
import numpy as np
import pytest
from athrl_driving.envs import TownEnv, TownVectorEnv
from athrl_driving.envs.settings import changed_settings
from athrl_driving.policy import EnvironmentBatch
from gymnasium.vector import SyncVectorEnv

CONFIG = {"vehicles_count": 5, "episode_ticks": 40}
COUNT = 3
STRAIGHT_ON = np.tile(np.array([[0.5, 0.0]], np.float32), (COUNT, 1))

KINDS = {
    "alone": lambda: gymnasium.make("athrl/Town02-v0", config=CONFIG),
    "sync": lambda: gymnasium.make_vec("athrl/Town02-v0", COUNT, "sync", config=CONFIG),
    "vector": lambda: gymnasium.make_vec("athrl/Town02-v0", COUNT, "vector_entry_point", config=CONFIG),
}


@pytest.mark.parametrize(
    "changes", [{"vehicles_count": 2}, {"ticks_per_decision": 2, "maximum_speed": 4.0}, {}, None]
)
def test_a_vector_follows_as_gymnasiums_vector_of_single_environments_does(changes: dict | None) -> None:
    ours = TownVectorEnv(COUNT, config=CONFIG)
    theirs = SyncVectorEnv([lambda: TownEnv(config=CONFIG)] * COUNT)
    seen = []
    for vector in (ours, theirs):
        vector.reset(seed=1)
        first, _ = vector.reset(seed=7, options={"config": changes})
        second, rewards, *_, infos = vector.step(STRAIGHT_ON)
        third, _ = vector.reset()  # the settings stay, and so do the random numbers
        seen.append([first, second, third, rewards, infos["ticks"]])
    for one, other in zip(*seen, strict=True):
        np.testing.assert_equal(one, other)
    settings = changes or {}
    assert ours.environment(1).road.background.x.size == settings.get("vehicles_count", 5)
    assert seen[0][-1].tolist() == [settings.get("ticks_per_decision", 4)] * COUNT
    assert ours.metadata["render_fps"] == theirs.envs[0].metadata["render_fps"]


def test_spaces_follow_the_settings() -> None:
    for env in (TownEnv(config=CONFIG), TownVectorEnv(COUNT, config=CONFIG)):
        observation, _ = env.reset(
            seed=1, options={"config": {"image_size": 16, "action": {"type": "WaypointSetAction"}}}
        )
        assert observation["image"].shape[-3:] == (16, 16, 4)
        assert observation in env.observation_space
        env.step(env.action_space.sample())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"config": {"vehicle_count": 2}}, "has no setting 'vehicle_count', did you mean 'vehicles_count'?"),
        ({"config": {"vehicles_count": -1}}, "vehicles_count is -1, it should be a whole number from 0"),
        ({"config": {"start": ("Nowhere", -1, 1.0)}}, "Nowhere"),
        ({"config": [1]}, "config is [1], it should be a dict of settings"),
        ({"confg": {}}, "reset has no option 'confg', did you mean 'config'?"),
        ({"seed": 1}, "reset has no option 'seed', there is 'config'"),
    ],
)
def test_what_cannot_be_followed_is_refused_in_one_line_and_changes_nothing(
    kind: str, options: dict, said: str
) -> None:
    env = KINDS[kind]()
    env.reset(seed=1)
    with pytest.raises(ValueError, match=re.escape(said)) as refusal:
        env.reset(seed=2, options=options)
    assert "\n" not in str(refusal.value)
    untouched = KINDS[kind]()
    action = STRAIGHT_ON[0] if kind == "alone" else STRAIGHT_ON
    for each in (untouched, env):
        each.reset(seed=3)
    np.testing.assert_equal(env.step(action)[:2], untouched.step(action)[:2])
    env.close()
    untouched.close()


def test_some_environments_of_a_vector_have_no_settings_of_their_own() -> None:
    vector = TownVectorEnv(COUNT, config=CONFIG)
    options = {"config": {"vehicles_count": 2}, "reset_mask": np.array([True, False, True])}
    with pytest.raises(ValueError, match="all environments have the same settings"):
        vector.reset(seed=1, options=options)
    vector.reset(seed=1, options={**options, "reset_mask": np.ones(COUNT, bool)})
    assert vector.environment(1).road.background.x.size == 2


def test_vectors_that_share_their_images_go_on_sharing_them() -> None:
    batch = EnvironmentBatch(["town02", "town03"], CONFIG)
    for vector, config in zip(batch._vectors, ({"vehicles_count": 2}, {"vehicles_count": 3}), strict=True):
        with pytest.raises(ValueError, match="image_size is 16, it should stay 32: the vector shares"):
            vector.reset(options={"config": {"image_size": 16}})
        vector.reset(seed=1, options={"config": config})
        vector.step_environments(np.zeros((1, 2), np.float32), np.ones(1, bool))
    alone = TownEnv({**CONFIG, "vehicles_count": 3}, map="town03")
    alone.reset(seed=1)
    observation, *_ = alone.step(np.zeros(2, np.float32))
    np.testing.assert_array_equal(batch.images[1], observation["image"])
    batch.close()


def test_no_two_environments_share_their_settings() -> None:
    mine, defaults = {"action": {"type": "DirectAction"}}, TownEnv.default_config()
    settings = changed_settings(defaults, mine, None)
    mine["action"]["type"] = "WaypointAction"
    defaults["centering_position"][0] = 0.1
    assert settings["action"] == {"type": "DirectAction"}
    assert TownEnv.default_config()["centering_position"] == [0.5, 0.5]


# Settings that are written to `config`, as in highway-env

WRITTEN = [
    lambda config: config.update(vehicles_count=2),
    lambda config: config.__setitem__("action", {"type": "DirectAction"}),
    lambda config: config["action"].update(type="DirectAction"),
    lambda config: config.update(ticks_per_decision=2, image_size=16),
    lambda config: config.pop("vehicles_count"),
]


@pytest.mark.parametrize("write", WRITTEN)
@pytest.mark.parametrize("kind", ["alone", "vector"])
def test_what_is_written_to_config_holds_from_the_next_reset_on(kind: str, write: Callable) -> None:
    env, expected = KINDS[kind](), KINDS[kind]()
    settings = copy.deepcopy(expected.unwrapped.config)
    write(settings)
    expected.reset(seed=1)
    expected.reset(seed=2, options={"config": {**settings, "policy_frequency": None}})
    config = env.unwrapped.config
    for _ in range(2):  # whoever kept the dict can write to it again
        write(config)
        env.reset(seed=1)
    copied = pickle.loads(pickle.dumps(env))
    action = np.zeros(env.action_space.shape, np.float32)
    expected.reset(seed=3)
    answer = expected.step(action)
    for each in (env, copied):
        each.reset(seed=3)
        np.testing.assert_equal(each.step(action), answer)
        assert each.unwrapped.config == expected.unwrapped.config


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ({"vehicle_count": 2}, "has no setting 'vehicle_count', did you mean 'vehicles_count'?"),
        ({"vehicles_count": -1}, "vehicles_count is -1, it should be a whole number from 0"),
        ({"start": np.zeros(3)}, "the setting start is array([0., 0., 0.]), it should be None or"),
        ({"policy_frequency": 5}, "policy_frequency is 5, it should be 2.5"),
        ({"duration": 60}, "has no setting 'duration'"),
    ],
)
@pytest.mark.parametrize("kind", ["alone", "vector"])
def test_what_is_written_to_config_and_cannot_be_followed_is_refused(
    kind: str, written: dict, said: str
) -> None:
    env = KINDS[kind]()
    before = dict(env.unwrapped.config)
    env.reset(seed=1)
    env.unwrapped.config.update(written)
    for options in (None, {"config": {"image_size": 16}}):
        with pytest.raises(ValueError, match=re.escape(said)) as refusal:
            env.reset(seed=2, options=options)
        assert "\n" not in str(refusal.value)
    env.unwrapped.config.clear()
    env.reset(seed=2)
    assert env.unwrapped.config == before


def test_options_go_before_what_is_written_and_some_of_a_vector_follow_neither() -> None:
    for env in (TownEnv(config=CONFIG), vector := TownVectorEnv(COUNT, config=CONFIG)):
        env.config["vehicles_count"] = 2
        env.reset(seed=1, options={"config": {"vehicles_count": 3}})
        assert env.config["vehicles_count"] == 3
    vector.config["vehicles_count"] = 2
    with pytest.raises(ValueError, match="all environments have the same settings"):
        vector.reset(seed=1, options={"reset_mask": np.array([True, False, True])})
