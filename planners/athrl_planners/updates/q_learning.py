"""DQN (Mnih et al. 2015), double (van Hasselt et al. 2016) and dueling (Wang et al. 2016) as settings.

target    r + discount * Q'(s', argmax_a Q'(s', a))        double: argmax of the online Q
"""

from __future__ import annotations

import torch
from athrl_spaces import Discrete
from torch import Tensor, nn
from torch.nn import functional

from athrl_planners.networks.heads import ChoiceCritic
from athrl_planners.updates.rule import LevelNetworks, Step, UpdateRule


class QLearningRule(UpdateRule):
    """DQN: the choice with the highest value."""

    actor_delay = 0

    def set_up(self) -> None:
        """Check that the level decides one choice."""
        plan = self.plan
        if len(plan.actions) != 1 or not isinstance(plan.actions[0], Discrete):
            raise ValueError(f"level {plan.name} learns by dqn: it should decide one choice and nothing else")
        self.encoded_size = len(plan.actions[0].choices)

    def make_networks(self) -> LevelNetworks:
        """Critics."""
        inputs, settings = self.context_size + self.above_size, self.settings
        return LevelNetworks(
            None,
            [
                ChoiceCritic(
                    inputs, self.head_features, self.encoded_size, self.values.outputs, settings.dueling
                )
                for _ in range(settings.critics)
            ],
        )

    def encode(self, actions: Tensor) -> Tensor:
        """Index [n, 1] -> one-hot [n, choices]."""
        return functional.one_hot(actions[:, 0].long(), self.encoded_size).to(torch.float32)

    def decode(self, encoded: Tensor) -> Tensor:
        """One-hot [n, choices] -> index [n, 1]."""
        return encoded.argmax(dim=1, keepdim=True).to(torch.float32)

    def decide(self, deciding: nn.Module, context: Tensor, above: Tensor, noise: Tensor | None) -> Tensor:
        """The choice with the highest value."""
        return self.decode(self.values.mean(deciding(context, above)))

    def next_step(
        self, target: LevelNetworks, online: LevelNetworks, contexts: tuple[Tensor, Tensor], above: Tensor
    ) -> Step:
        """The best choice by the target critics or, with double DQN, by the online critic; and its value."""
        outputs = [critic(contexts[0], above).float() for critic in target.critics]
        chooser = online.critics[0](contexts[1], above).float() if self.settings.double else outputs[0]
        best = self.values.mean(chooser).argmax(dim=1)
        action = functional.one_hot(best, self.encoded_size).to(torch.float32)
        return Step(action, lambda: self.smaller([_of(output, action) for output in outputs]), None)

    def value_of(self, critic: nn.Module, context: Tensor, above: Tensor, taken: Tensor) -> Tensor:
        """Outputs of a critic for choices [n, choices]: [n, outputs]."""
        return _of(critic(context, above).float(), taken)

    @property
    def needs_online_next(self) -> bool:
        """Double DQN uses the online network's choice."""
        return bool(self.settings.double)

    @property
    def takes_noise(self) -> bool:
        """Choices are explored by forcing them."""
        return False


def _of(output: Tensor, taken: Tensor) -> Tensor:
    """Outputs of the taken choices, [n, outputs], of [n, choices, outputs]."""
    index = taken.argmax(dim=1).view(-1, 1, 1).expand(-1, 1, output.shape[2])
    return output.gather(1, index).squeeze(1)
