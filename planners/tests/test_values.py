"""What critics predict: the projection of a distribution, against a slow loop over its definition."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from athrl_planners.settings import PlannerSettings
from athrl_planners.updates import make_values

LOW, HIGH, ATOMS = -3.0, 5.0, 17
WIDTH = (HIGH - LOW) / (ATOMS - 1)
VALUES = make_values(PlannerSettings(value_min=LOW, value_max=HIGH, atoms=ATOMS))


def softmax(logits: np.ndarray) -> np.ndarray:
    powers = np.exp(logits - logits.max())
    return powers / powers.sum()


def projected(reward: float, discount: float, logits: np.ndarray) -> np.ndarray:
    """Bellemare et al. 2017, algorithm 1, atom by atom."""
    target = np.zeros(ATOMS)
    for number, probability in enumerate(softmax(logits)):
        value = min(max(reward + discount * (LOW + number * WIDTH), LOW), HIGH)
        place = (value - LOW) / WIDTH
        below, above = math.floor(place), math.ceil(place)
        if below == above:
            target[below] += probability
        else:
            target[below] += probability * (above - place)
            target[above] += probability * (place - below)
    return target


def random_cases() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    random = torch.Generator().manual_seed(1)
    reward = 6 * torch.randn(200, generator=random)
    discount = torch.rand(200, generator=random)
    discount[::5] = 0.0
    return reward, discount, 2 * torch.randn(200, ATOMS, generator=random)


def test_projection_is_the_papers_algorithm() -> None:
    reward, discount, logits = random_cases()
    target = VALUES.target(reward, discount, logits).double().numpy()
    cases = zip(reward, discount, logits, strict=True)
    slow = [projected(float(r), float(d), each.double().numpy()) for r, d, each in cases]
    np.testing.assert_allclose(target, np.stack(slow), atol=1e-5)


def test_projection_loses_no_mass() -> None:
    target = VALUES.target(*random_cases())
    torch.testing.assert_close(target.sum(dim=1), torch.ones(200))
    assert target.min() >= 0


def test_projection_has_the_right_mean_inside_the_support() -> None:
    random = torch.Generator().manual_seed(2)
    logits = torch.randn(50, ATOMS, generator=random)
    reward = torch.rand(50, generator=random) - 0.5
    discount = torch.full((50,), 0.8)  # -0.5 + 0.8 * -3 and 0.5 + 0.8 * 5 lie within -3..5
    target = VALUES.target(reward, discount, logits)
    torch.testing.assert_close(VALUES.target_mean(target), reward + 0.8 * VALUES.mean(logits))


def test_what_lies_beyond_the_support_comes_to_its_ends() -> None:
    logits = torch.zeros(2, ATOMS)
    target = VALUES.target(torch.tensor([-100.0, 100.0]), torch.tensor([0.9, 0.9]), logits)
    assert target[0, 0] == pytest.approx(1, abs=1e-6)
    assert target[1, -1] == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("reward", [LOW, LOW + 3 * WIDTH, HIGH])
def test_atom_that_is_hit_takes_everything(reward: float) -> None:
    target = VALUES.target(torch.tensor([reward]), torch.zeros(1), torch.zeros(1, ATOMS))
    number = round((reward - LOW) / WIDTH)
    assert target[0, number] == pytest.approx(1, abs=1e-6)


def test_what_follows_an_end_makes_no_difference() -> None:
    reward, end = torch.tensor([0.3]), torch.zeros(1)
    one, other = (VALUES.target(reward, end, factor * torch.arange(17.0)[None]) for factor in (0.0, 3.0))
    torch.testing.assert_close(one, other, atol=1e-6, rtol=0)


def test_loss_is_the_cross_entropy() -> None:
    random = torch.Generator().manual_seed(3)
    output, target = torch.randn(9, ATOMS, generator=random), torch.rand(9, ATOMS, generator=random)
    target /= target.sum(dim=1, keepdim=True)
    expected = torch.nn.functional.cross_entropy(output, target, reduction="none")
    torch.testing.assert_close(VALUES.loss(output, target), expected)


@pytest.mark.parametrize(("loss", "expected"), [("squared", [0.25, 9.0]), ("huber", [0.125, 2.5])])
def test_scalar_critics_have_the_loss_that_is_set(loss: str, expected: list[float]) -> None:
    values = make_values(PlannerSettings(critic="scalar", loss=loss))  # type: ignore[arg-type]
    output, target = torch.tensor([[1.5], [4.0]]), torch.tensor([1.0, 1.0])
    assert values.loss(output, target).tolist() == pytest.approx(expected)
    assert values.target(target, torch.tensor([0.5, 0.0]), output).tolist() == [1.75, 1.0]
