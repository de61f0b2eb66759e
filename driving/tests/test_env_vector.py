"""A vector of towns equals single towns: the same numbers for any other environments and threads."""

import subprocess
import sys

import athrl_driving  # noqa: F401  (registers the environments)
import gymnasium
import numpy as np
import pytest
from athrl_driving.envs import TownEnv, TownVectorEnv
from athrl_driving.episode import Workers
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

CONFIG = {"vehicles_count": 20, "episode_ticks": 24}
COUNT = 5


def new_vector(count: int = COUNT, **settings: object) -> TownVectorEnv:
    return TownVectorEnv(count, config=CONFIG, **settings)


def assert_same(one: object, other: object, where: str = "") -> None:
    """Two nested structures of dicts and arrays hold the same values, bit for bit, of the same types."""
    assert type(one) is type(other), where
    if isinstance(one, dict):
        assert set(one) == set(other), where
        for key in one:
            assert_same(one[key], other[key], f"{where}/{key}")
    elif isinstance(one, tuple) or (isinstance(one, np.ndarray) and one.dtype == object):
        for index, pair in enumerate(zip(one, other, strict=True)):
            assert_same(*pair, f"{where}/{index}")
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, where
        np.testing.assert_array_equal(one, other, err_msg=where)
    else:
        assert one == other, where


def random_actions(seed: int, steps: int, count: int) -> NDArray[np.float32]:
    return np.random.default_rng(seed).uniform(-1, 1, (steps, count, 2)).astype(np.float32)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_it_does_what_gymnasiums_own_vector_of_single_environments_does(mode: AutoresetMode) -> None:
    ours = new_vector(autoreset_mode=mode)
    theirs = SyncVectorEnv([lambda: TownEnv(config=CONFIG)] * COUNT, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] == mode
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert_same(ours.reset(seed=3), theirs.reset(seed=3))
    ended = 0
    for actions in random_actions(1, 40, COUNT):
        results, expected = ours.step(actions), theirs.step(actions)
        assert_same(results, expected)
        done = results[2] | results[3]
        ended += int(done.sum())
        if mode == AutoresetMode.DISABLED and done.any():
            resets = [vector.reset(options={"reset_mask": done.copy()}) for vector in (ours, theirs)]
            assert_same(*resets)
    assert ended > COUNT


@settings(deadline=None, max_examples=15)
@given(
    seed=st.integers(0, 2**31),
    count=st.integers(1, 12),
    threads=st.integers(1, 3),
    env_index=st.integers(0, 11),
    actions=st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=1, max_size=8),
)
def test_an_environment_does_not_depend_on_the_others(
    seed: int, count: int, threads: int, env_index: int, actions: list[tuple[float, float]]
) -> None:
    env_index %= count
    vector, alone = new_vector(count, threads=threads), TownEnv(config=CONFIG)
    observations, _ = vector.reset(seed=seed)
    observation, _ = alone.reset(seed=seed + env_index)
    others = random_actions(seed, len(actions), count)
    for action, others_actions in zip(actions, others, strict=True):
        for name, expected in observation.items():
            np.testing.assert_array_equal(observations[name][env_index], expected)
        others_actions[env_index] = action
        observations, rewards, terminated, truncated, infos = vector.step(others_actions)
        observation, *expected, info = alone.step(others_actions[env_index])
        assert [rewards[env_index], terminated[env_index], truncated[env_index]] == expected
        assert infos["distance"][env_index] == info["distance"]
        traffic, background = vector.environment(env_index).road.background, alone.road.background
        np.testing.assert_array_equal(traffic.x, background.x)
        if terminated[env_index] or truncated[env_index]:
            break
    vector.close()


@pytest.mark.parametrize(("threads", "work"), [(1, 1), (2, 2), (3, 3), (4, 3), (99, 3)])
def test_threads_are_a_bound_and_each_has_four_environments_at_least(threads: int, work: int) -> None:
    vector = new_vector(14, threads=threads)
    assert vector.threads == work
    sizes = [end - begin for begin, end in vector.episodes.slice_bounds]
    assert len(sizes) == work
    assert sum(sizes) == 14
    assert min(sizes) >= 4
    vector.close()


def test_without_a_number_there_is_a_thread_for_each_core_of_the_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda process: {0, 3, 5})
    vector = new_vector(64)
    assert vector.threads == 3
    vector.close()


_FORK = """
import os, signal, threading
import numpy as np
from athrl_driving.envs import TownVectorEnv

def report():
    rewards = vector.step(np.zeros((8, 2), np.float32))[1]
    print(rewards.tolist(), sum("athrl-drive" in each.name for each in threading.enumerate()), flush=True)

vector = TownVectorEnv(8, config={"vehicles_count": 5}, threads=2)
vector.reset(seed=1)
vector.step(np.zeros((8, 2), np.float32))
child = os.fork()
if child == 0:
    signal.alarm(60)
    report()
    vector.close()
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
report()
vector.close()
"""


def test_a_forked_process_goes_on_with_threads_of_its_own() -> None:
    result = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", _FORK], capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 0, result.stderr
    child, parent = result.stdout.splitlines()
    assert child == parent
    assert child.endswith("] 1")


def test_make_vec_makes_it() -> None:
    vector = gymnasium.make_vec(
        "athrl/Town03-v0",
        num_envs=3,
        vectorization_mode="vector_entry_point",
        config=CONFIG,
        autoreset_mode="SameStep",
    )
    assert isinstance(vector, TownVectorEnv)
    assert vector.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    observations, infos = vector.reset(seed=0)
    assert observations in vector.observation_space
    assert infos["_speed"].all()
    assert vector.step(vector.action_space.sample())[0] in vector.observation_space
    vector.close()


def test_results_are_the_callers_own() -> None:
    vector = new_vector()
    observations, _ = vector.reset(seed=1)
    kept = {name: values.copy() for name, values in observations.items()}
    _, rewards, *_ = vector.step(np.ones((COUNT, 2), np.float32))
    kept_rewards = rewards.copy()
    vector.step(np.ones((COUNT, 2), np.float32))
    assert_same(observations, kept)
    np.testing.assert_array_equal(rewards, kept_rewards)


def test_environments_can_be_stepped_by_themselves() -> None:
    vector = new_vector(autoreset_mode=AutoresetMode.DISABLED)
    vector.reset(seed=2)
    before = vector.scene(1)
    rewards, *_, infos = vector.step_environments(np.ones((COUNT, 2), np.float32), np.arange(COUNT) != 1)
    assert vector.scene(1).ego == before.ego
    assert vector.scene(1).step == 0
    assert vector.scene(2).step == 1
    assert rewards[1] == 0.0
    assert infos["_ticks"].tolist() == [True, False, True, True, True]
    assert infos["ticks"].tolist() == [4, 0, 4, 4, 4]


def test_an_environment_is_seen_as_a_single_one() -> None:
    vector, alone = new_vector(), TownEnv(config=CONFIG)
    vector.reset(seed=7)
    alone.reset(seed=9)
    view = vector.environment(2)
    np.testing.assert_array_equal(view.vehicle.position, alone.vehicle.position)
    np.testing.assert_array_equal(view.route.waypoints(), alone.route.waypoints())
    assert view.road.leader_of_ego() == alone.road.leader_of_ego()
    assert view.scene().ego == alone.scene().ego
    assert view.unwrapped is view
    assert view.town is alone.town
    assert view.action_type.maximum_speed == alone.action_type.maximum_speed


def test_an_ended_episode_waits_for_its_reset() -> None:
    vector = new_vector(autoreset_mode=AutoresetMode.DISABLED)
    with pytest.raises(ResetNeeded, match=r"no episode has begun in environments \[0, 1, 2, 3, 4\]"):
        vector.step(np.zeros((COUNT, 2), np.float32))
    vector.reset(seed=0)
    ended = np.zeros(COUNT, bool)
    while not ended.any():
        _, _, terminated, truncated, _ = vector.step(np.ones((COUNT, 2), np.float32))
        ended = terminated | truncated
    with pytest.raises(ResetNeeded, match="have ended: reset them before the step"):
        vector.step(np.zeros((COUNT, 2), np.float32))


def test_seeds_may_be_an_array() -> None:
    one, other = new_vector(), new_vector()
    listed, _ = one.reset(seed=[3, 4, 5, 6, 7])
    in_array, _ = other.reset(seed=np.arange(3, 8))
    np.testing.assert_array_equal(in_array["image"], listed["image"])


def test_closing_a_vector_leaves_shared_threads_to_the_others() -> None:
    shared = Workers(2)
    first, second = (TownVectorEnv(8, config={"vehicles_count": 2}, workers=shared) for _ in range(2))
    first.close()
    second.reset(seed=1)
    second.step(np.zeros((8, 2), np.float32))
    second.close()
    shared.close()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: TownVectorEnv(0), "num_envs is 0, it should be a whole number, 1 or more"),
        (lambda: TownVectorEnv(1, threads=0), "threads is 0, it should be a whole number, 1 or more"),
        (lambda: TownVectorEnv(1, threads=-2), "threads is -2, it should be a whole number, 1 or more"),
        (lambda: TownVectorEnv(1, threads=1.5), "threads is 1.5, it should be a whole number, 1 or more"),
        (lambda: TownVectorEnv(1, threads=True), "threads is True, it should be a whole number, 1 or more"),
        (
            lambda: TownVectorEnv(1, autoreset_mode="Next"),
            "autoreset_mode is 'Next', it should be 'NextStep' or 'SameStep' or 'Disabled'",
        ),
        (lambda: TownVectorEnv(1, config={"vehicle_count": 1}), "did you mean 'vehicles_count'"),
        (lambda: TownVectorEnv(1, config=[1]), r"config is \[1\], it should be a dict of settings"),
        (lambda: new_vector().reset(seed=1.5), "seed is 1.5, it should be a whole number or a list of 5"),
        (lambda: new_vector().reset(seed=[1, 2]), "2 seeds were given, there should be one for each of 5"),
        (
            lambda: new_vector().step(np.zeros((2, 2))),
            r"the array of actions has shape \(2, 2\), it should be \(5, 2\)",
        ),
        (
            lambda: new_vector().step(np.array([[0, 0], [0, 0], [0, np.nan], [0, 0], [0, 0]])),
            r"the action of environments \[2\] is \[0.0, nan\]",
        ),
        (
            lambda: new_vector().reset(options={"reset_mask": np.zeros(COUNT, bool)}),
            "reset_mask names no environment",
        ),
        (
            lambda: new_vector().reset(options={"reset_mask": [True] * COUNT}),
            "it should be a bool array of 5",
        ),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(call: object, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        call()
    assert "\n" not in str(error.value)
