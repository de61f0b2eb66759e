"""An accelerated environment that is pickled is an independent copy in the same state, here and elsewhere."""

from __future__ import annotations

import hashlib
import multiprocessing
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from operator import methodcaller
from typing import Any

import cloudpickle
import gymnasium
import numpy as np
import pytest
from athrl_accelerate import accelerate
from gymnasium.wrappers import RecordEpisodeStatistics

DEADLINE = 200
"""Seconds within which another process has to answer; it imports everything first."""


def _through_buffers(env: Any, read_only: bool) -> Any:
    buffers: list[pickle.PickleBuffer] = []
    data = pickle.dumps(env, protocol=5, buffer_callback=buffers.append)
    memory = [buffer.raw().toreadonly() if read_only else buffer.raw() for buffer in buffers]
    return pickle.loads(data, buffers=memory)


FORMS: dict[str, Callable[[Any], Any]] = {
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
    "cloudpickle": lambda env: pickle.loads(cloudpickle.dumps(env)),
    "memory that is read only": lambda env: _through_buffers(env, read_only=True),
    "memory in common": lambda env: _through_buffers(env, read_only=False),
}


def under_way(name: str) -> gymnasium.Env:
    env = accelerate(gymnasium.make(name))
    env.reset(seed=1)
    for _ in range(3):
        env.step(np.array([0.5, 0.1], np.float32) if name == "parking-v0" else 1)
    return env


def drive_on(env: gymnasium.Env, decisions: int) -> str:
    """Hash of everything that the environment answers; at an end a new episode begins."""
    digest, chance = hashlib.sha256(), np.random.default_rng(3)
    for _ in range(decisions):
        space = env.action_space  # highway-env makes another one, with a seed of its own, at every reset
        space.seed(int(chance.integers(1000)))
        *results, terminated, truncated, info = env.step(space.sample())
        digest.update(repr((results, terminated, truncated, info)).encode())
        if terminated or truncated:
            digest.update(repr(env.reset()[0]).encode())
    return digest.hexdigest()


@pytest.mark.parametrize(
    "name", ["highway-fast-v0", "merge-v1", "roundabout-v1", "intersection-v2", "parking-v0"]
)
def test_a_pickled_environment_drives_on_exactly_like_the_original(name: str) -> None:
    env = under_way(name)
    copied = pickle.loads(pickle.dumps(env))
    assert drive_on(copied, 100) == drive_on(env, 100)


@pytest.mark.parametrize("form", FORMS)
def test_neither_the_copy_nor_the_original_moves_the_other(form: str) -> None:
    env, expected = under_way("highway-fast-v0"), under_way("highway-fast-v0")
    copied = FORMS[form](env)
    assert copied.unwrapped.road.vehicles[3].road is copied.unwrapped.road
    drive_on(copied, 5)
    answers = drive_on(expected, 10)
    assert drive_on(env, 10) == answers
    assert drive_on(FORMS[form](under_way("highway-fast-v0")), 10) == answers


def test_wrappers_around_it_travel_too() -> None:
    env = RecordEpisodeStatistics(under_way("highway-fast-v0"))
    env.reset(seed=2)
    copied = pickle.loads(pickle.dumps(env))
    np.testing.assert_array_equal(copied.step(1)[0], env.step(1)[0])


def test_it_drives_on_in_another_process() -> None:
    env = under_way("highway-fast-v0")
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        there = pool.submit(methodcaller("step", 1), env).result(timeout=DEADLINE)
    here = env.step(1)
    np.testing.assert_array_equal(there[0], here[0])
    assert repr(there[1:]) == repr(here[1:])
