"""The interface of update rules. A rule is for one level; its decisions are encoded.

Encoded numbers are in [-1, 1], an encoded choice is one-hot. `context` float32 [n, context] is the output of
a trunk, `above` float32 [n, above] the decisions of the levels above; it may have no columns.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from athrl_spaces import Action
from torch import Tensor, nn

from athrl_planners.planner import LevelPlan
from athrl_planners.updates.noise import NoiseSource
from athrl_planners.updates.values import Values


class LevelNetworks(nn.Module):
    """The heads of a level: critics, and an actor unless choices follow from the values."""

    def __init__(self, actor: nn.Module | None, critics: list[nn.Module]) -> None:
        super().__init__()
        self.actor = actor
        self.critics = nn.ModuleList(critics)

    @property
    def deciding(self) -> nn.Module:
        """The published network: the actor, or the critic whose best choice is taken."""
        return self.critics[0] if self.actor is None else self.actor


class Step(NamedTuple):
    """A level's next decision, for a target."""

    action: Tensor
    """[n, encoded]"""
    output: Callable[[], Tensor]
    """Computes the output of the target critic that counts: [n, outputs]."""
    bonus: Tensor | None
    """[n] added to the value, in scaled reward."""


class Objective(NamedTuple):
    """The objective of an actor."""

    gain: Tensor
    """[n]"""
    action: Tensor
    """[n, encoded], with its gradient."""
    raw: Tensor
    """[n, actions] before the tanh."""


class UpdateRule(ABC, nn.Module):
    """Decides and computes targets and objectives of a level.

    Attributes:
        encoded_size: columns of its encoded decision.
        actor_delay: policy delay, critic updates for each actor update; 0 without an actor.
    """

    encoded_size: int
    actor_delay: int

    def __init__(
        self,
        plan: LevelPlan,
        settings: Any,
        values: Values,
        sizes: tuple[int, int],
        noise: NoiseSource,
    ) -> None:
        """`sizes` are the columns of the context and of the decisions above; `noise` is for updates."""
        super().__init__()
        self.plan, self.settings, self.values = plan, settings, values
        self.context_size, self.above_size = sizes
        self.noise = noise
        self.set_up()

    @abstractmethod
    def set_up(self) -> None:
        """Check the plan, set `encoded_size` and `actor_delay`, and keep what the rule needs.

        Called when `plan`, `settings`, `values`, sizes and `noise` are set. Raises ValueError if the rule
        cannot learn the level's actions.
        """

    @property
    def head_features(self) -> int:
        """Width of the hidden layers of the level's actor and critics."""
        return self.plan.head_features or int(self.settings.head_features)

    @abstractmethod
    def make_networks(self) -> LevelNetworks:
        """New networks."""

    @abstractmethod
    def encode(self, actions: Tensor) -> Tensor:
        """Encode decisions [n, n_actions] in physical units, or an index: [n, encoded]."""

    @abstractmethod
    def decode(self, encoded: Tensor) -> Tensor:
        """Inverse of `encode`."""

    @abstractmethod
    def decide(self, deciding: nn.Module, context: Tensor, above: Tensor, noise: Tensor | None) -> Tensor:
        """Decision [n, n_actions], physical units or index, within its range; part of the artefact."""

    @abstractmethod
    def next_step(
        self, target: LevelNetworks, online: LevelNetworks, contexts: tuple[Tensor, Tensor], above: Tensor
    ) -> Step:
        """The next decision and its value; `contexts` are those of the target and the online trunk."""

    @abstractmethod
    def value_of(self, critic: nn.Module, context: Tensor, above: Tensor, taken: Tensor) -> Tensor:
        """Outputs of a critic for decisions [n, encoded]: [n, outputs]."""

    def objective(
        self, networks: LevelNetworks, context: Tensor, above: Tensor, penalised: bool = True
    ) -> Objective:
        """The actor's objective, if there is an actor; without penalties it is for the level above."""
        raise NotImplementedError

    def target_output(self, target: LevelNetworks, context: Tensor, above: Tensor, taken: Tensor) -> Tensor:
        """Outputs of the target critics for decisions [n, encoded], with two the smaller: [n, outputs]."""
        return self.smaller([self.value_of(critic, context, above, taken) for critic in target.critics])

    def smaller(self, outputs: list[Tensor]) -> Tensor:
        """Per row, the outputs [n, outputs] of the critic with the smaller value, of one or two."""
        if len(outputs) == 1:
            return outputs[0]
        first, second = outputs
        smaller = self.values.mean(first) < self.values.mean(second)
        return torch.where(smaller.unsqueeze(-1), first, second)

    @property
    def needs_online_next(self) -> bool:
        """Whether `next_step` uses the online trunk's contexts."""
        return False

    @property
    def takes_noise(self) -> bool:
        """Whether `decide` takes noise."""
        return True


def centre_and_half_range(actions: tuple[Action, ...]) -> tuple[Tensor, Tensor]:
    """Centre and half-range of continuous actions: float32 [n] each."""
    low = torch.tensor([action.bounds[0] for action in actions])
    high = torch.tensor([action.bounds[1] for action in actions])
    return (high + low) / 2, (high - low) / 2
