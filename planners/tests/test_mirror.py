"""Left and right exchanged, against pictures and decisions made by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from athrl_planners import Agent, Sequence, SequenceReplay, TransitionBatch
from athrl_planners.training.mirror import mirrored

Arrays = dict[str, np.ndarray]
ROWS = 40


class Chosen:
    """In place of a random generator: which rows of a batch are exchanged."""

    def __init__(self, rows: list[int]) -> None:
        self.rows = rows

    def random(self, count: int) -> np.ndarray:
        values = np.ones(count)
        values[self.rows] = 0
        return values


@pytest.fixture
def sample(
    new_agent: Callable[..., Agent],
    new_sequence: Callable[..., Sequence],
    replay_of: Callable[..., SequenceReplay],
) -> Callable[..., tuple[Agent, TransitionBatch]]:
    def make(kind: str, **settings: Any) -> tuple[Agent, TransitionBatch]:
        agent = new_agent(kind, **settings)
        batch = replay_of(agent, [new_sequence(agent, seed) for seed in range(3)]).sample(ROWS)
        assert isinstance(batch, TransitionBatch)
        return agent, batch

    return make


def copied(batch: TransitionBatch) -> TransitionBatch:
    columns = {name: np.copy(value) for name, value in vars(batch).items() if isinstance(value, np.ndarray)}
    levels = {
        name: {level: column.copy() for level, column in value.items()}
        for name, value in vars(batch).items()
        if isinstance(value, dict)
    }
    return replace(batch, **columns, **levels)


def exchange(agent: Agent, batch: TransitionBatch, rows: list[int]) -> TransitionBatch:
    return mirrored(copied(batch), agent.state.levels, Chosen(rows))  # type: ignore[arg-type]


KINDS = [("athrl", {"intention_every": 3}), ("ddpg", {}), ("hdqn", {}), ("hddpg", {})]


@pytest.mark.parametrize(("kind", "settings"), KINDS)
def test_mirroring_twice_is_nothing(sample: Any, kind: str, settings: dict[str, Any]) -> None:
    agent, batch = sample(kind, **settings)
    rows = list(range(0, ROWS, 3))
    once = exchange(agent, batch, rows)
    twice = exchange(agent, once, rows)
    for name, value in vars(batch).items():
        if name in ("actions", "last_actions"):
            for level, column in value.items():
                np.testing.assert_allclose(vars(twice)[name][level], column, atol=1e-6)
        else:
            np.testing.assert_equal(vars(twice)[name], value)
    assert not np.array_equal(once.images, batch.images)


def test_picture_is_turned_about_the_cars_own_axis(sample: Any) -> None:
    agent, batch = sample("hddpg")
    batch.images[:] = 0
    batch.images[0, 0, 1, 2, 3] = 200  # row 1 from the top, column 2 from the left, lidar
    batch.images[1, 0, 6, 0, 1] = 100
    after = exchange(agent, batch, [0]).images
    assert after[0, 0, 1, 5, 3] == 200
    assert after[1, 0, 6, 7, 1] == 100
    assert after.sum() == batch.images.sum()


def test_steering_changes_its_sign_and_speed_does_not(sample: Any) -> None:
    agent, batch = sample("hddpg")
    after = exchange(agent, batch, [0, 5]).motion
    sign = np.ones((ROWS, 2), np.float32)
    sign[[0, 5], 1] = -1
    np.testing.assert_array_equal(after, batch.motion * sign)


@pytest.mark.parametrize(
    ("kind", "level", "before", "after"),
    [
        ("athrl", "intention", [[0.0], [0.3], [1.0]], [[2.0], [1.7], [1.0]]),
        ("athrl", "trajectory", [[7.0, 0.2], [3.0, -0.5], [0.0, 0.0]], [[7.0, -0.2], [3.0, 0.5], [0.0, 0.0]]),
        ("ddpg", "control", [[-2.0, 0.1], [3.0, -0.3], [1.0, 0.0]], [[-2.0, -0.1], [3.0, 0.3], [1.0, 0.0]]),
        ("hdqn", "behaviour", [[0], [1], [2]], [[0], [1], [2]]),
        ("hdqn", "waypoint", [[0], [11], [7]], [[7], [12], [0]]),  # 8 at each radius, left to right
    ],
)
def test_decisions_change_sides(
    sample: Any, kind: str, level: str, before: list[list[float]], after: list[list[float]]
) -> None:
    agent, batch = sample(kind)
    batch.actions[level][:3] = before
    batch.last_actions[level][:, :3] = before
    turned = exchange(agent, batch, [0, 1, 2])
    np.testing.assert_allclose(turned.actions[level][:3], after, atol=1e-6)
    for horizon in turned.last_actions[level]:
        np.testing.assert_allclose(horizon[:3], after, atol=1e-6)


def test_rows_that_are_not_chosen_stay_as_they_are(sample: Any) -> None:
    agent, batch = sample("athrl")
    after = exchange(agent, batch, [1])
    others = [row for row in range(ROWS) if row != 1]
    np.testing.assert_array_equal(after.images[:, others], batch.images[:, others])
    for level, column in batch.actions.items():
        np.testing.assert_array_equal(after.actions[level][others], column[others])
    np.testing.assert_equal(after.rewards, batch.rewards)


def test_about_half_is_mirrored_in_training_and_the_replay_keeps_what_it_has(
    new_agent: Callable[..., Agent],
    new_sequence: Callable[..., Sequence],
    replay_of: Callable[..., SequenceReplay],
) -> None:
    agent = new_agent("hddpg", mirror=True)
    sequence = new_sequence(agent, 1)
    sequence.actions["trajectory"][:] = [4.0, 0.3]
    replay = replay_of(agent, [sequence])
    angles = [agent.prepare(replay.sample(100)).levels["trajectory"].taken[:, 1].numpy() for _ in range(10)]
    assert 0.4 < (np.concatenate(angles) < 0).mean() < 0.6
    np.testing.assert_array_equal(replay.columns()["images"][0], sequence.images)
    np.testing.assert_array_equal(replay.columns()["trajectory.actions"][0], sequence.actions["trajectory"])
