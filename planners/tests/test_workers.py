"""Parts of an update that threads compute side by side add up to the whole."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from athrl_planners import Agent, Sequence, SequenceReplay, TrainingDiverged
from athrl_planners.factories import make_agent
from athrl_planners.training.workers import Workers
from athrl_spaces import Observation

SMALL = {"hidden_features": 16, "head_features": 24, "atoms": 11}


@pytest.fixture
def experience(
    new_sequence: Callable[..., Sequence], replay_of: Callable[..., SequenceReplay]
) -> Callable[[Agent], SequenceReplay]:
    return lambda agent: replay_of(agent, [new_sequence(agent, seed, terminated=True) for seed in range(9)])


def agent(kind: str, threads: int, **settings: Any) -> Agent:
    values = {**SMALL, **settings}
    return make_agent(kind, values, observation=Observation(8), seed=1, threads=threads)


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        ("athrl", {"td3_target_noise": 0.0}),
        ("athrl", {"td3_target_noise": 0.0, "intention_every": 3, "trajectory_view": "near route"}),
        ("hddpg", {"update_rule": "ddpg", "critic": "scalar", "critics": 1}),
        ("hdqn", {}),
    ],
)
@pytest.mark.parametrize("threads", [2, 3])
def test_update_in_parts_is_the_update_in_one(
    experience: Callable[[Agent], SequenceReplay], kind: str, settings: dict[str, Any], threads: int
) -> None:
    whole, parted = agent(kind, 1, **settings), agent(kind, threads, **settings)
    replay = experience(whole)
    for _ in range(4):
        batch = replay.sample(31)
        metrics, errors = whole.update(batch)
        metrics_in_parts, errors_in_parts = parted.update(batch)
        torch.testing.assert_close(errors_in_parts, errors, rtol=1e-4, atol=1e-5)
        for name, value in metrics.items():
            torch.testing.assert_close(metrics_in_parts[name], value, rtol=1e-3, atol=1e-5)
    wanted = whole.state_dict()["networks"]
    for name, tensor in parted.state_dict()["networks"].items():
        torch.testing.assert_close(tensor, wanted[name], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("decisions", [1, 2, 5])
def test_batch_of_fewer_decisions_than_threads_is_trained_like_any(
    experience: Callable[[Agent], SequenceReplay], decisions: int
) -> None:
    whole, parted = (agent("athrl", threads, td3_target_noise=0.0) for threads in (1, 6))
    batch = experience(whole).sample(decisions)
    metrics, errors = whole.update(batch)
    metrics_in_parts, errors_in_parts = parted.update(batch)
    torch.testing.assert_close(errors_in_parts, errors, rtol=1e-4, atol=1e-5)
    for name, value in metrics.items():
        torch.testing.assert_close(metrics_in_parts[name], value, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("settings", [{}, {"update_rule": "sac"}])
def test_update_in_parts_repeats_itself_bit_for_bit(
    experience: Callable[[Agent], SequenceReplay], settings: dict[str, Any]
) -> None:
    first, second = (agent("athrl", 2, **settings) for _ in range(2))
    replay = experience(first)
    for _ in range(5):
        batch = replay.sample(20)
        first.update(batch)
        second.update(batch)
    for name, tensor in first.state_dict()["networks"].items():
        assert torch.equal(tensor, second.state_dict()["networks"][name])


def test_part_draws_its_own_noise_on_every_thread(
    experience: Callable[[Agent], SequenceReplay], monkeypatch: pytest.MonkeyPatch
) -> None:
    class OneThread(Workers):
        def each(self, compute: Callable[[int, Any], Any], parts: Any) -> list[Any]:
            return [compute(number, part) for number, part in enumerate(parts)]

    first, second = (agent("athrl", 3, update_rule="sac") for _ in range(2))
    monkeypatch.setattr(second, "_workers", OneThread(3))
    batch = experience(first).sample(20)
    first.update(batch)
    second.update(batch)
    for name, tensor in first.state_dict()["networks"].items():
        assert torch.equal(tensor, second.state_dict()["networks"][name])


def test_parts_are_computed_at_the_same_time() -> None:
    all_threads = threading.Barrier(3)

    def meet(number: int, part: str) -> str:
        all_threads.wait(timeout=30)
        return f"{number}{part}"

    assert Workers(3).each(meet, ["a", "b", "c"]) == ["0a", "1b", "2c"]


@pytest.mark.parametrize("failing", [0, 1])
def test_part_that_fails_is_told_when_all_have_returned(failing: int) -> None:
    returned = []

    def compute(number: int, part: int) -> None:
        if number == failing:
            raise ValueError(f"part {part}")
        returned.append(number)

    with pytest.raises(ValueError, match=f"part {failing}"):
        Workers(2).each(compute, [0, 1])
    assert returned == [1 - failing]


def test_loss_that_is_not_finite_in_one_part_changes_nothing(
    experience: Callable[[Agent], SequenceReplay],
) -> None:
    parted = agent("athrl", 2)
    batch = experience(parted).sample(20)
    batch.rewards["trajectory"][-1] = np.nan
    before = {name: tensor.clone() for name, tensor in parted.state_dict()["networks"].items()}
    with pytest.raises(TrainingDiverged):
        parted.update(batch)
    for name, tensor in parted.state_dict()["networks"].items():
        assert torch.equal(tensor, before[name])
