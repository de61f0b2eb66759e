"""SAC (Haarnoja et al. 2018): stochastic actors with an entropy bonus.

target       r + discount * (min_i Q_i'(s', a') - temperature * log pi'(a' | s')),  a' ~ pi'(. | s')
actor        maximise  min_i Q_i(s, a) - temperature * log pi(a | s),                a ~ pi(. | s)
temperature  rises while the entropy is below its target, else falls
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from athrl_planners.updates.deterministic import ContinuousRule
from athrl_planners.updates.rule import LevelNetworks, Objective, Step

LOG_DEVIATION = (-5.0, 1.0)
"""Bounds of the logarithm of an action's deviation before the tanh."""


class SoftRule(ContinuousRule):
    """SAC with a learnt temperature; targets use the target actor, in Haarnoja et al. the online one."""

    stochastic = True
    actor_delay = 1

    def set_up(self) -> None:
        """The temperature, and the entropy to which it is held."""
        super().set_up()
        settings = self.settings
        self.log_temperature = nn.Parameter(torch.tensor(math.log(settings.sac_temperature)))
        self._wanted_entropy = settings.sac_target_entropy * self.encoded_size

    def decide(self, deciding: nn.Module, context: Tensor, above: Tensor, noise: Tensor | None) -> Tensor:
        """The mean action, or with standard normal `noise` a sampled one."""
        mean, deviation = _distribution(deciding(context, above))
        raw = mean if noise is None else mean + deviation * noise
        return self.decode(torch.tanh(raw))

    def next_step(
        self, target: LevelNetworks, online: LevelNetworks, contexts: tuple[Tensor, Tensor], above: Tensor
    ) -> Step:
        """A sampled action of the target actor, and its value by the target critics with its entropy."""
        assert target.actor is not None
        action, log_probability, _ = self._sample(target.actor(contexts[0], above).float())
        bonus = -self.log_temperature.detach().exp() * log_probability
        return Step(action, lambda: self.target_output(target, contexts[0], above, action), bonus)

    def objective(
        self, networks: LevelNetworks, context: Tensor, above: Tensor, penalised: bool = True
    ) -> Objective:
        """The smaller critic's value of a sampled action with its entropy; also trains the temperature."""
        assert networks.actor is not None
        action, log_probability, raw = self._sample(networks.actor(context, above).float())
        output = self.smaller([self.value_of(critic, context, above, action) for critic in networks.critics])
        gain = self.values.mean(output)
        if not penalised:
            return Objective(gain, action, raw)
        gain = gain - self.log_temperature.detach().exp() * log_probability
        missing = log_probability.detach() + self._wanted_entropy
        return Objective(gain + self.log_temperature * missing, action, raw)

    def _sample(self, output: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """A sampled action [n, actions], its log density [n], and the mean [n, actions] before the tanh."""
        mean, deviation = _distribution(output)
        noise = self.noise.normal_like(mean)
        raw = mean + deviation * noise
        log_density = -0.5 * noise.square() - deviation.log() - 0.5 * math.log(2 * math.pi)
        # log(1 - tanh(x)^2), exact where tanh is 1
        squashed = 2 * (math.log(2) - raw - functional.softplus(-2 * raw))
        return torch.tanh(raw), (log_density - squashed).sum(dim=1), mean


def _distribution(output: Tensor) -> tuple[Tensor, Tensor]:
    mean, log_deviation = output.chunk(2, dim=1)
    low, high = LOG_DEVIATION
    return mean, (low + (high - low) * (torch.tanh(log_deviation) + 1) / 2).exp()
