"""Value representations of critics: the mean return, or a distribution over returns (C51)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from athrl_planners.settings import PlannerSettings


class ScalarValues(nn.Module):
    """A critic with one output, the value. Targets are float32 [n]."""

    outputs = 1

    def __init__(self, settings: PlannerSettings) -> None:
        super().__init__()
        self._huber = settings.loss == "huber"

    def mean(self, output: Tensor) -> Tensor:
        """[..., 1] -> the value [...]."""
        return output.squeeze(-1)

    def target(self, reward: Tensor, discount: Tensor, next_output: Tensor) -> Tensor:
        """reward [n] + discount [n] * the value of `next_output` [n, 1]."""
        return reward + discount * self.mean(next_output)

    def loss(self, output: Tensor, target: Tensor) -> Tensor:
        """The loss of each prediction [n, 1] against a target [n]: [n]."""
        loss = functional.huber_loss if self._huber else functional.mse_loss
        return loss(self.mean(output), target, reduction="none")

    def target_mean(self, target: Tensor) -> Tensor:
        """The mean value of a target [n]: [n]."""
        return target


class DistributionalValues(nn.Module):
    """A critic whose outputs are logits of atoms, evenly spaced from `value_min` to `value_max`.

    Bellemare et al. 2017, "A Distributional Perspective on Reinforcement Learning" (C51). Targets are
    probabilities, float32 [n, atoms].
    """

    support: Tensor

    def __init__(self, settings: PlannerSettings) -> None:
        super().__init__()
        self.outputs = settings.atoms
        self._low, self._high = settings.value_min, settings.value_max
        self.register_buffer(
            "support", torch.linspace(self._low, self._high, settings.atoms), persistent=False
        )

    def mean(self, output: Tensor) -> Tensor:
        """Logits [..., atoms] -> the value [...]."""
        return (output.softmax(dim=-1) * self.support).sum(dim=-1)

    def target(self, reward: Tensor, discount: Tensor, next_output: Tensor) -> Tensor:
        """The distribution of reward [n] + discount [n] * value, with logits `next_output` [n, atoms].

        The mass of each shifted atom goes to its two neighbouring atoms; beyond the support, to its end.
        """
        probabilities = next_output.softmax(dim=1)
        width = (self._high - self._low) / (self.outputs - 1)
        shifted = (reward[:, None] + discount[:, None] * self.support).clamp(self._low, self._high)
        place = (shifted - self._low) / width
        below = place.floor()
        share = place - below
        index = below.long().clamp(0, self.outputs - 1)  # a NaN reward stays NaN in the shares
        target = torch.zeros_like(probabilities)
        target.scatter_add_(1, index, probabilities * (1 - share))
        return target.scatter_add_(1, (index + 1).clamp(max=self.outputs - 1), probabilities * share)

    def loss(self, output: Tensor, target: Tensor) -> Tensor:
        """The cross entropy of logits [n, atoms] against a target [n, atoms]: [n]."""
        return -(target * functional.log_softmax(output, dim=1)).sum(dim=1)

    def target_mean(self, target: Tensor) -> Tensor:
        """The mean value of a target [n, atoms]: [n]; as a matrix product it would be rounded to bfloat16."""
        return (target * self.support).sum(dim=1)


Values = ScalarValues | DistributionalValues


def make_values(settings: PlannerSettings) -> Values:
    """The representation that `settings.critic` names."""
    return ScalarValues(settings) if settings.critic == "scalar" else DistributionalValues(settings)
