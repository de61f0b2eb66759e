"""What every update rule can do. A rule knows one level; what it says is normalised.

Numbers lie in [-1, 1], a choice is written as one 1 among zeros. `context` float32 [n, context] is a trunk's
output, `above` float32 [n, above] what the levels above have decided, perhaps of no columns.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from athrl_spaces import Action
from torch import Tensor, nn

from athrl_planners.noise import NoiseSource
from athrl_planners.planner import LevelPlan
from athrl_planners.updates.values import Values


class LevelNetworks(nn.Module):
    """The heads of a level: an actor, unless a choice follows from the values, and critics."""

    def __init__(self, actor: nn.Module | None, critics: list[nn.Module]) -> None:
        super().__init__()
        self.actor = actor
        self.critics = nn.ModuleList(critics)

    @property
    def deciding(self) -> nn.Module:
        """What is published: the actor, or the critic whose best choice is taken."""
        return self.critics[0] if self.actor is None else self.actor


class Step(NamedTuple):
    """A level's next decision as a target sees it."""

    action: Tensor
    """[n, encoded]"""
    output: Callable[[], Tensor]
    """Computes what the target critic that counts says: [n, outputs]."""
    bonus: Tensor | None
    """[n] added to the value, in scaled reward."""


class Objective(NamedTuple):
    """What an actor climbs."""

    gain: Tensor
    """[n]"""
    action: Tensor
    """[n, encoded], with its gradient."""
    raw: Tensor
    """[n, actions] before the tanh."""


class UpdateRule(ABC, nn.Module):
    """How a level decides and learns.

    Attributes:
        encoded_size: columns of its decision as networks see it.
        actor_delay: critic updates for each actor update; 0: there is no actor.
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
        """`sizes` are columns of the context and of what is decided above; `noise` is for updates."""
        super().__init__()
        self.plan, self.settings, self.values = plan, settings, values
        self.context_size, self.above_size = sizes
        self.noise = noise

    @property
    def head_features(self) -> int:
        """Width of the hidden layers of the level's actor and critics."""
        return self.plan.head_features or int(self.settings.head_features)

    @abstractmethod
    def make_networks(self) -> LevelNetworks:
        """Fresh networks."""

    @abstractmethod
    def encode(self, actions: Tensor) -> Tensor:
        """Decisions [n, n_actions] in physical units, or an index, as networks see them: [n, encoded]."""

    @abstractmethod
    def decode(self, encoded: Tensor) -> Tensor:
        """The reverse of `encode`."""

    @abstractmethod
    def decide(self, deciding: nn.Module, context: Tensor, above: Tensor, noise: Tensor | None) -> Tensor:
        """A decision [n, n_actions], physical units or index, in its range; part of the artefact."""

    @abstractmethod
    def following(
        self, target: LevelNetworks, online: LevelNetworks, contexts: tuple[Tensor, Tensor], above: Tensor
    ) -> Step:
        """The next decision and its value; `contexts` are the target trunk's and the online trunk's there."""

    @abstractmethod
    def value_of(self, critic: nn.Module, context: Tensor, above: Tensor, taken: Tensor) -> Tensor:
        """What a critic says about decisions [n, encoded]: [n, outputs]."""

    def objective(
        self, networks: LevelNetworks, context: Tensor, above: Tensor, penalised: bool = True
    ) -> Objective:
        """What the actor climbs, only where there is one; without its penalties what a level above climbs."""
        raise NotImplementedError

    def target_output(self, target: LevelNetworks, context: Tensor, above: Tensor, taken: Tensor) -> Tensor:
        """What target critics say about decisions [n, encoded], of two the smaller: [n, outputs]."""
        return self.smaller([self.value_of(critic, context, above, taken) for critic in target.critics])

    def smaller(self, outputs: list[Tensor]) -> Tensor:
        """Of the outputs [n, outputs] of one or two critics the one with the smaller value, row by row."""
        if len(outputs) == 1:
            return outputs[0]
        first, second = outputs
        smaller = self.values.mean(first) < self.values.mean(second)
        return torch.where(smaller.unsqueeze(-1), first, second)

    @property
    def needs_online_following(self) -> bool:
        """Whether `following` looks at the online trunk's contexts."""
        return False

    @property
    def takes_noise(self) -> bool:
        """Whether `decide` takes noise."""
        return True


def centre_and_half_range(actions: tuple[Action, ...]) -> tuple[Tensor, Tensor]:
    """Of continuous actions: float32 [n] each."""
    low = torch.tensor([action.bounds[0] for action in actions])
    high = torch.tensor([action.bounds[1] for action in actions])
    return (high + low) / 2, (high - low) / 2
