"""Levels that are paid different terms of the reward, from the environments to the replay, serially."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.policy import OnnxPolicy

from tests.serial_runs import drive_serially, everything, require_equal, torch_left_as_it_was

pytestmark = pytest.mark.timeout(300)

TINY = (
    "serial.enabled=true",
    "run.environment_steps=240",
    "environment.vehicles=10",
    "environment.episode_ticks=120",
    "exploration.random_decisions=60",
    "planner.hidden_features=16",
    "planner.head_features=16",
    "planner.atoms=11",
    "replay.capacity=300",
    "replay.sequence_length=10",
    "learner.batch=40",
    "learner.samples_per_insert=4",
    "actor.environments=3",
    "evaluator.episodes=2",
    "evaluator.final_episodes=2",
    "serial.trace_updates=5",
)


@pytest.fixture(scope="module", autouse=True)
def torch_as_it_was() -> Iterator[None]:
    with torch_left_as_it_was():
        yield


def test_intention_that_is_paid_for_progress_earns_what_steering_cost_the_trajectory(tmp_path: Path) -> None:
    settings = (*TINY, "planner.intention_target=experience", "planner.intention_reward=progress")
    assert drive_serially(tmp_path, "whole", settings)
    assert not drive_serially(tmp_path, "halves", settings, stop_at=130)
    assert drive_serially(tmp_path, "halves", settings, resume=True)
    whole = everything(tmp_path / "whole")
    require_equal(whole, everything(tmp_path / "halves"))
    assert whole["state"]["updates"] > 10

    above, below = (whole["replay"][f"{level}.rewards"] for level in ("intention", "trajectory"))
    assert (above > below + 0.01).mean() > 0.5  # a random driver steers in nearly every decision
    assert (above > below - 1e-3).all()
    assert np.ptp(above - below) > 0.1

    policy = OnnxPolicy.load(tmp_path / "whole" / "policies" / "latest.onnx")
    intention, trajectory = policy.description.levels
    assert intention.rewarded == ("collision", "speed", "fast", "out", "constant")
    assert trajectory.rewarded == ()


def test_levels_that_are_paid_the_tasks_reward_earn_the_same(tmp_path: Path) -> None:
    assert drive_serially(tmp_path, "whole", TINY)
    replay = everything(tmp_path / "whole")["replay"]
    assert replay["intention.rewards"].any()
    np.testing.assert_array_equal(replay["intention.rewards"], replay["trajectory.rewards"])
