"""A fleet for each test, under whose settings experience flows steadily and nothing of the log is removed."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.liveness.fleet import Fleet

STEADY = {
    "run.environment_steps": 10_000_000,
    "replay.capacity": 20_000,
    "learner.samples_per_insert": 0.1,  # so that no actor waits for training
    "learner.publish_seconds": 0.1,
    # Not a small one: who publishes it to a paused router is soon in the middle of sending.
    "planner.hidden_features": 256,
    "planner.head_features": 256,
    "learner.checkpoint_seconds": 10.0,
    "learner.checkpoints_kept": 1000,
    "evaluator.seconds_between": 0.0,
}


@pytest.fixture
def steady(tiny: list[str]) -> list[str]:
    """Settings of a run that lasts as long as the test."""
    return [*tiny, *(word for key, value in STEADY.items() for word in ("--set", f"{key}={value}"))]


@pytest.fixture(autouse=True)
def _tell_where_it_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a service that is aborted write down where each of its threads was."""
    monkeypatch.setenv("PYTHONFAULTHANDLER", "1")


@pytest.fixture
def fleet(command, steady: list[str], port: int) -> Iterator[Fleet]:
    """A run of which nothing has been started; its learner's address is of this machine's loopback."""
    return Fleet(command, steady, f"tcp/127.0.0.1:{port}")
