"""Updates in bfloat16 round the networks' products, and nothing that follows from them."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from athrl_planners import Sequence, SequenceReplay, make_agent
from athrl_planners.settings import PlannerSettings
from athrl_planners.training.losses import weighted_sum
from athrl_planners.training.precision import autocast
from athrl_planners.updates import make_values
from athrl_spaces import Observation

CPU = torch.device("cpu")


def test_weighted_sum_is_not_rounded() -> None:
    """bfloat16 has a third as 0.333984375, and nothing between 2.328 and 2.344."""
    third = torch.full((3,), 1 / 3, requires_grad=True)
    with autocast(CPU, torch.bfloat16):
        total = weighted_sum(torch.tensor([1.0, 2.0, 4.0]), third)
    assert total.dtype == torch.float32
    assert float(total.detach()) == pytest.approx(7 / 3, rel=1e-6)


def test_mean_of_a_distributional_target_is_not_rounded() -> None:
    """Atoms are 0.48 apart: 0.25 * 12.00 + 0.75 * 12.48, where bfloat16 has 12.3125 and 12.375."""
    values = make_values(PlannerSettings(atoms=101, value_min=-24.0, value_max=24.0))
    target = torch.zeros(1, 101)
    target[0, 75], target[0, 76] = 0.25, 0.75
    with autocast(CPU, torch.bfloat16):
        mean = values.target_mean(target)
    assert mean.dtype == torch.float32
    assert float(mean) == pytest.approx(12.36, abs=1e-4)


def test_what_an_update_says_is_float32(
    new_sequence: Callable[..., Sequence], replay_of: Callable[..., SequenceReplay]
) -> None:
    agent = make_agent(
        "athrl", {"hidden_features": 16, "head_features": 24}, observation=Observation(8),
        precision=torch.bfloat16,
    )  # fmt: skip
    replay = replay_of(agent, [new_sequence(agent, seed, terminated=True) for seed in range(3)])
    for _ in range(2):  # with and without actors
        metrics, errors = agent.update(replay.sample(12))
        assert {value.dtype for value in (*metrics.values(), errors)} == {torch.float32}
