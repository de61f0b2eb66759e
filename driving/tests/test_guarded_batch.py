"""Environments that raise or stall are replaced, and late results of their calls are discarded."""

import threading
import time

import numpy as np
import pytest
from athrl_driving.policy import (
    EnvironmentBatch,
    EnvironmentRaised,
    EnvironmentStalled,
    GuardedBatch,
    guard,
)

CONFIG = {"vehicles_count": 2, "episode_ticks": 40}
STRAIGHT_ON = np.zeros((2, 2), np.float32)


@pytest.fixture
def batch():
    guarded = GuardedBatch(["town03"] * 2, CONFIG, seconds=30)
    begin(guarded)
    yield guarded
    guarded.close()


def begin(batch: EnvironmentBatch | GuardedBatch) -> None:
    for env_index in range(2):
        batch.reset(env_index, seed=env_index)


def test_guarded_environments_do_what_unguarded_ones_do(batch: GuardedBatch):
    plain = EnvironmentBatch(["town03"] * 2, CONFIG)
    begin(plain)
    for _ in range(5):
        expected, outcome = plain.step(STRAIGHT_ON), batch.step(STRAIGHT_ON)
        np.testing.assert_array_equal(outcome.rewards, expected.rewards)
        np.testing.assert_array_equal(batch.images, plain.images)
        np.testing.assert_array_equal(batch.motion, plain.motion)
        assert batch.info(1) == plain.info(1)
    plain.close()


def test_step_that_raises_replaces_all_environments(batch: GuardedBatch, monkeypatch):
    broken = batch.environments[0]

    def fail(self, actions, active=None):
        raise ZeroDivisionError("no\nlane")

    with monkeypatch.context() as patch:
        patch.setattr(EnvironmentBatch, "step", fail)
        with pytest.raises(EnvironmentRaised, match=r"step raised ZeroDivisionError: no lane$") as failure:
            batch.step(STRAIGHT_ON)
    assert failure.value.env_indices == [0, 1]
    assert batch.environments[0] is not broken
    begin(batch)
    assert np.isfinite(batch.step(STRAIGHT_ON).rewards).all()


def test_reset_that_raises_costs_one_environment_only(batch: GuardedBatch, monkeypatch):
    def fail(self, env_index, seed):
        raise ValueError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(EnvironmentBatch, "reset", fail)
        with pytest.raises(EnvironmentRaised, match="reset of environment 1 raised ValueError") as failure:
            batch.reset(1, seed=5)
    assert failure.value.env_indices == [1]
    assert np.isfinite(batch.step(STRAIGHT_ON).rewards).all()


def test_own_timeout_of_an_environment_is_no_stall(batch: GuardedBatch, monkeypatch):
    def fail(self, actions, active=None):
        raise TimeoutError("simulator")

    monkeypatch.setattr(EnvironmentBatch, "step", fail)
    with pytest.raises(EnvironmentRaised, match="TimeoutError: simulator"):
        batch.step(STRAIGHT_ON)


def test_step_that_stalls_is_abandoned_and_changes_nothing_when_it_returns(monkeypatch):
    monkeypatch.setattr(guard, "POLL_SECONDS", 0.05)
    batch = GuardedBatch(["town03"] * 2, CONFIG, seconds=30)
    begin(batch)
    batch.step(STRAIGHT_ON)
    resume, returned = threading.Event(), threading.Event()
    step = EnvironmentBatch.step

    def stall(self, actions, active=None):
        assert resume.wait(60)
        outcome = step(self, actions, active)
        returned.set()
        return outcome

    with monkeypatch.context() as patch:
        patch.setattr(EnvironmentBatch, "step", stall)
        batch._seconds = 0.2
        with pytest.raises(EnvironmentStalled, match=r"step did not return within 0\.2 s") as failure:
            batch.step(STRAIGHT_ON)
        batch._seconds = 30
    assert failure.value.env_indices == [0, 1]
    begin(batch)
    seen = batch.images.copy()
    resume.set()
    assert returned.wait(60)
    np.testing.assert_array_equal(batch.images, seen)
    assert np.isfinite(batch.step(STRAIGHT_ON).rewards).all()
    batch.close()


def test_first_call_may_take_as_long_as_compilation_does(monkeypatch):
    """The deadline only holds for calls that have been compiled."""
    monkeypatch.setattr(guard, "POLL_SECONDS", 0.01)
    step = EnvironmentBatch.step

    def compile_first(self, actions, active=None):
        threading.Event().wait(1.0)
        return step(self, actions, active)

    monkeypatch.setattr(EnvironmentBatch, "step", compile_first)
    batch = GuardedBatch(["town03"] * 2, CONFIG, seconds=30)
    begin(batch)
    batch._seconds = 0.5  # also for the environments that replace the stalled ones
    batch.step(STRAIGHT_ON)
    with pytest.raises(EnvironmentStalled):
        batch.step(STRAIGHT_ON)
    batch.close()


def test_environments_that_cannot_be_made_leave_no_thread_behind():
    before = threading.active_count()
    with pytest.raises(ValueError, match="there is no town named 'town99'"):
        GuardedBatch(["town99"], CONFIG, seconds=30)
    deadline = time.monotonic() + 10.0
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threading.active_count() <= before
