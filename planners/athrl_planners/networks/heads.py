"""Heads: small networks on the context of a trunk."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class Head(nn.Sequential):
    """Two hidden layers: [n, inputs] -> [n, outputs]."""

    def __init__(self, inputs: int, hidden: int, outputs: int) -> None:
        super().__init__(
            nn.Linear(inputs, hidden),
            nn.LayerNorm(hidden),
            nn.ReLU(),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
            nn.Linear(hidden, outputs),
        )

    @property
    def last(self) -> nn.Linear:
        """The output layer."""
        layer = self[-1]
        assert isinstance(layer, nn.Linear)
        return layer


class Actor(nn.Module):
    """Context and decisions above -> an action before its tanh, and its log deviation (SAC)."""

    def __init__(self, inputs: int, hidden: int, actions: int, random: bool) -> None:
        super().__init__()
        self.actions = actions
        self.layers = Head(inputs, hidden, actions * (2 if random else 1))
        # Starts in the middle of the ranges, far from saturation.
        nn.init.uniform_(self.layers.last.weight, -3e-3, 3e-3)
        nn.init.zeros_(self.layers.last.bias)

    def forward(self, context: Tensor, above: Tensor) -> Tensor:
        """[n, context], normalised [n, above] -> [n, actions]; random: [n, 2 actions]."""
        return self.layers(torch.cat((context, above), dim=1))


class Critic(nn.Module):
    """Context, decisions above and action -> outputs that represent the value."""

    def __init__(self, inputs: int, hidden: int, outputs: int) -> None:
        super().__init__()
        self.layers = Head(inputs, hidden, outputs)

    def forward(self, *inputs: Tensor) -> Tensor:
        """[n, ...] each -> [n, outputs]."""
        return self.layers(torch.cat(inputs, dim=1))


class ChoiceCritic(nn.Module):
    """Context and decisions above -> the values of every choice."""

    def __init__(self, inputs: int, hidden: int, choices: int, outputs: int, dueling: bool) -> None:
        super().__init__()
        self.choices, self.outputs = choices, outputs
        self.advantage = Head(inputs, hidden, choices * outputs)
        self.state = Head(inputs, hidden, outputs) if dueling else None

    def forward(self, context: Tensor, above: Tensor) -> Tensor:
        """[n, context], [n, above] -> [n, choices, outputs]."""
        inputs = torch.cat((context, above), dim=1)
        advantage = self.advantage(inputs).unflatten(1, (self.choices, self.outputs))
        if self.state is None:
            return advantage
        return self.state(inputs).unsqueeze(1) + advantage - advantage.mean(dim=1, keepdim=True)
