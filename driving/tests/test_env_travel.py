"""A pickled environment is an independent copy in the same state, in this process and in others."""

from __future__ import annotations

import copy
import dataclasses
import multiprocessing
import os
import pickle
import shutil
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import athrl_driving  # noqa: F401  (registers the environments)
import cloudpickle
import gymnasium
import joblib
import numpy as np
import pytest
from athrl_driving.envs import TownEnv, TownVectorEnv
from athrl_driving.episode import workers
from athrl_driving.episode.own_arrays import own_arrays
from athrl_driving.errors import DrivingError
from athrl_driving.maps import MapError, load_town
from athrl_driving.policy.batch import EnvironmentBatch
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from gymnasium.wrappers import RecordEpisodeStatistics, TimeLimit
from highway_env.vehicle.objects import Obstacle
from stable_baselines3.common.vec_env import SubprocVecEnv

sys.path.insert(0, str(Path(__file__).parent))  # so that other processes find the module
from travelled import drive_on, same_moment

DECISIONS = 200
CONFIG = {"vehicles_count": 20, "episode_ticks": 60}
SLOWLY = np.array([-0.5, 0.0], np.float32)
DEADLINE = 200
"""Seconds within which another process has to answer; it imports everything first."""

TOWN02 = Path(sys.modules["athrl_driving"].__path__[0]) / "maps" / "towns" / "town02.xodr"

ENVIRONMENTS: dict[str, Callable[[], Any]] = {
    "town": lambda: gymnasium.make("athrl/Town02-v0", config=CONFIG),
    "OpenDRIVE file": lambda: gymnasium.make("athrl/OpenDrive-v0", map=TOWN02, config=CONFIG),
    "town read strictly": lambda: TownEnv({**CONFIG, "strict_map": True}, map=str(TOWN02)),
    "scenario": lambda: gymnasium.make("athrl/Roundabout-v0", config=CONFIG),
    "wrapped": lambda: RecordEpisodeStatistics(TimeLimit(TownEnv(CONFIG, map="town02"), 9)),
    "vector": lambda: TownVectorEnv(8, CONFIG, map="town02", threads=2),
    "vector that resets within a step": lambda: TownVectorEnv(
        3, CONFIG, map="town02", autoreset_mode=AutoresetMode.SAME_STEP
    ),
}

FORMS: dict[str, Callable[[Any], Any]] = {
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
    "the oldest pickle": lambda env: pickle.loads(pickle.dumps(env, protocol=2)),
    "cloudpickle": lambda env: pickle.loads(cloudpickle.dumps(env)),
    "buffers out of band": lambda env: _through_buffers(env),
    "deepcopy": copy.deepcopy,
}


def _through_buffers(env: Any) -> Any:
    """Hand the arrays over in memory that is shared and can only be read, as joblib and Ray do."""
    buffers: list[pickle.PickleBuffer] = []
    data = pickle.dumps(env, protocol=5, buffer_callback=buffers.append)
    return pickle.loads(data, buffers=[buffer.raw().toreadonly() for buffer in buffers])


def under_way(name: str = "town") -> Any:
    """One of the environments in the middle of an episode, with its random numbers in use."""
    env = ENVIRONMENTS[name]()
    env.action_space.seed(2)
    env.reset(seed=1)
    drive_on(env, 5)
    return env


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_pickled_environment_drives_on_exactly_like_the_original(name: str) -> None:
    env = under_way(name)
    copied = pickle.loads(pickle.dumps(env))
    assert drive_on(copied, DECISIONS) == drive_on(env, DECISIONS)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["town", "vector"])
def test_neither_the_copy_nor_the_original_moves_the_other(name: str, form: str) -> None:
    env, expected = under_way(name), under_way(name)
    copied = FORMS[form](env)
    drive_on(copied, 7)
    assert drive_on(env, 20) == (answers := drive_on(expected, 20))
    late = FORMS[form](under_way(name))
    del env
    assert drive_on(late, 20) == answers


def test_a_copy_shows_the_same_moment() -> None:
    env = under_way()
    copied = pickle.loads(pickle.dumps(env))
    assert same_moment(env, copied)
    drive_on(copied, 1)
    assert not same_moment(env, copied)


def test_obstacles_on_the_road_travel_and_stop_the_copy_as_they_stop_the_original() -> None:
    env = TownEnv({"vehicles_count": 0}, map="town02")
    env.reset(seed=7)
    place = env.vehicle.position + 9.0 * env.vehicle.direction
    env.road.objects.append(Obstacle(env.road, place, env.vehicle.heading))
    copies = [env, pickle.loads(pickle.dumps(env)), copy.deepcopy(env)]
    assert copies[1].road.objects[0].road is copies[1].road
    for each in copies:
        infos = [each.step(np.array([1.0, 0.0], np.float32))[4] for _ in range(8)]
        assert infos[-1]["collision"]


def test_a_vector_of_some_of_many_observations_travels_with_them() -> None:
    batch = EnvironmentBatch(["town02", "town03"] * 2, {"vehicles_count": 3, "image_size": 16}, recorded=4)
    vector = batch._vectors[1]
    vector.reset(seed=1)
    copied = pickle.loads(pickle.dumps(vector))
    for each in (vector, copied):
        each.step_environments(np.zeros((2, 2), np.float32), np.ones(2, np.bool_))
    assert copied.images[[1, 3]].any()
    np.testing.assert_array_equal(copied.images[[1, 3]], vector.images[[1, 3]])
    recorded = [each.episodes.state.observations.recording_buffer.images for each in (vector, copied)]
    np.testing.assert_array_equal(recorded[1][[1, 3]], recorded[0][[1, 3]])
    copied.reset(options={"config": {"vehicles_count": 2}})
    assert copied.images.shape == (4, 16, 16, 4)


def test_everything_that_driving_changes_is_in_the_copy() -> None:
    episodes = under_way("vector").episodes
    state, own = episodes.state, own_arrays(episodes.state)
    others = {name: array for name, array in _all_arrays(state) if name not in own}
    before = {name: array.copy() for name, array in others.items()}
    seen = before.pop("observations.recording_buffer.seen")
    episodes.begin(np.arange(8), [np.random.default_rng(5)] * 8)
    assert seen.shape == own["observations.images"].reshape(8, -1).shape
    for name, array in before.items():
        np.testing.assert_array_equal(others[name], array, err_msg=name)


def _all_arrays(value: tuple, path: str = "") -> Any:
    for name, field in value._asdict().items():  # type: ignore[attr-defined]
        if isinstance(field, np.ndarray):
            yield path + name, field
        elif isinstance(field, tuple):
            yield from _all_arrays(field, f"{path}{name}.")


# Other processes


@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_an_environment_drives_on_in_a_process_of_multiprocessing(method: str) -> None:
    env, vector = under_way(), under_way("vector")
    with ProcessPoolExecutor(1, multiprocessing.get_context(method)) as pool:
        answers = [pool.submit(drive_on, each, DECISIONS) for each in (env, vector)]
        there = [answer.result(timeout=DEADLINE) for answer in answers]
    assert there == [drive_on(each, DECISIONS) for each in (env, vector)]


def test_environments_drive_on_in_processes_of_joblib() -> None:
    env, vector = under_way(), TownVectorEnv(64, {**CONFIG, "image_size": 128}, map="town02")
    vector.reset(seed=3)
    assert vector.images.nbytes > 2**20, "joblib maps larger arrays into memory that can only be read"
    with joblib.parallel_config(backend="loky", n_jobs=2, inner_max_num_threads=1):
        calls = [joblib.delayed(drive_on)(each, 20) for each in (env, vector)]
        there = joblib.Parallel(timeout=DEADLINE)(calls)
    assert there == [drive_on(each, 20) for each in (env, vector)]


def test_an_environment_drives_on_in_a_process_of_stable_baselines3() -> None:
    env = under_way()
    env.reset()
    vector = SubprocVecEnv([lambda: env], start_method="spawn")
    try:
        for _ in range(5):  # an end would be followed by a reset there
            observations, rewards, *_ = vector.step(SLOWLY[None])
            expected = env.step(SLOWLY)
            np.testing.assert_array_equal(observations["image"][0], expected[0]["image"])
            assert rewards[0] == expected[1]
    finally:
        vector.close()


def test_an_environment_drives_on_in_a_process_of_gymnasium() -> None:
    env = under_way()
    vector = AsyncVectorEnv([lambda: env], context="spawn")
    try:
        vector.reset_async()
        observations, _ = vector.reset_wait(timeout=DEADLINE)
        np.testing.assert_array_equal(observations["image"][0], env.reset()[0]["image"])
        for _ in range(5):
            vector.step_async(SLOWLY[None])
            observations, rewards, *_ = vector.step_wait(timeout=DEADLINE)
            expected = env.step(SLOWLY)
            np.testing.assert_array_equal(observations["image"][0], expected[0]["image"])
            assert rewards[0] == expected[1]
    finally:
        vector.close(terminate=True)


# Towns


def test_a_town_travels_by_its_name_and_not_by_value() -> None:
    env = under_way()
    town = env.unwrapped.town
    assert len(pickle.dumps(town)) < 500
    assert pickle.loads(pickle.dumps(town)) is town
    assert copy.deepcopy(town) is copy.copy(town) is town
    of_the_town = dict(_all_arrays(env.unwrapped.episodes.state.perception.drivable))
    assert len(pickle.dumps(env)) < sum(array.nbytes for array in of_the_town.values()) / 10
    assert pickle.loads(pickle.dumps(env)).unwrapped.town is town
    assert str(TOWN02.parent).encode() not in pickle.dumps(env), "another installation has other paths"


def test_a_map_is_found_from_another_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(TOWN02, tmp_path / "stored")
    (tmp_path / "mine.xodr").symlink_to(tmp_path / "stored")
    monkeypatch.chdir(tmp_path)
    env = gymnasium.make("athrl/OpenDrive-v0", map="mine.xodr", config=CONFIG)
    vector = gymnasium.make_vec("athrl/OpenDrive-v0", num_envs=2, map="mine.xodr", config=CONFIG)
    data = pickle.dumps((env, vector))
    monkeypatch.chdir("/")
    copied, copied_vector = pickle.loads(data)
    copied.reset(options={"config": {"vehicles_count": 2}})
    copied_vector.reset(options={"config": {"vehicles_count": 2}})
    assert copied.unwrapped.town is copied_vector.town is env.unwrapped.town


def test_another_map_under_the_same_name_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "mine.xodr"
    shutil.copy(TOWN02, path)
    data = pickle.dumps(TownEnv(CONFIG, map=path))
    path.write_text(path.read_text().replace("<header", "<header  ", 1))
    os.utime(path, ns=(1, 1))
    with pytest.raises(MapError, match=r"mine.xodr is another map than .* pickled \(SHA-256 .*, should be"):
        pickle.loads(data)
    path.unlink()
    with pytest.raises(MapError, match=r"mine.xodr: there is no such file"):
        pickle.loads(data)


# What does not travel


def test_an_open_window_stays_and_a_picture_is_drawn_again() -> None:
    env = TownEnv(CONFIG, render_mode="human", map="town02")
    env.reset(seed=1)
    with pytest.raises(DrivingError, match=r"an open window cannot be pickled: close\(\) it before"):
        pickle.dumps(env)
    assert copy.deepcopy(env).viewer is None
    env.close()
    assert pickle.loads(pickle.dumps(env)).render_mode == "human"
    env = TownEnv(CONFIG, render_mode="rgb_array", map="town02")
    env.reset(seed=1)
    picture = env.render()
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(env)).render(), picture)


def test_an_environment_that_a_thread_is_stepping_is_refused_in_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    env = under_way()
    began, go_on, drive = threading.Event(), threading.Event(), workers.drive

    def slow_drive(*arguments: Any) -> None:
        began.set()
        assert go_on.wait(DEADLINE)
        drive(*arguments)

    monkeypatch.setattr(workers, "drive", slow_drive)
    thread = threading.Thread(target=drive_on, args=(env, 1))
    thread.start()
    try:
        assert began.wait(DEADLINE)
        with pytest.raises(DrivingError, match=r"cannot be copied while a thread drives them"):
            pickle.dumps(env)
    finally:
        go_on.set()
        thread.join(DEADLINE)
    assert same_moment(pickle.loads(pickle.dumps(env)), env)


def test_what_has_no_copy_says_so_in_one_line() -> None:
    with pytest.raises(DrivingError, match=r"a batch cannot be pickled: make another one from its towns"):
        pickle.dumps(EnvironmentBatch(["town02"], {"vehicles_count": 0}))
    with pytest.raises(MapError, match=r"'town02' cannot be pickled: it was not read from a file"):
        pickle.dumps(dataclasses.replace(load_town("town02"), file=None))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda state: state["arrays"].pop("progress.ego"), r"they have no array progress.ego"),
        (lambda state: state["arrays"].update(more=np.zeros(1)), r"they have an unknown array more"),
        (
            lambda state: state["arrays"].update({"progress.ego": np.zeros((2, 8))}),
            r"progress.ego is float64 \[2, 8\], should be float64 \[1, 8\]",
        ),
        (
            lambda state: state["arrays"].update({"progress.ticks": np.zeros(1)}),
            r"progress.ticks is float64 \[1\], should be int64 \[1\]",
        ),
        (lambda state: state["settings"].update(speed=1), r"unexpected keyword argument 'speed'"),
        (lambda state: state.pop("town"), r"they have no entry 'town'"),
        (lambda state: state.update(vehicles=10**6), r"the town has room for \d+ at most"),
    ],
)
def test_a_state_that_does_not_fit_is_refused_in_one_line(
    damage: Callable[[dict], object], message: str
) -> None:
    episodes = under_way().unwrapped.episodes
    state = {**copy.deepcopy(episodes.__getstate__()), "version": "0.1"}
    damage(state)
    with pytest.raises(
        DrivingError, match=rf"copied by athrl-driving 0.1, cannot be made by .*{message}"
    ) as error:
        type(episodes).__new__(type(episodes)).__setstate__(state)
    assert "\n" not in str(error.value)
