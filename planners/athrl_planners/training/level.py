"""One level of a planner in training: its update rule and its online, target and averaged heads."""

from __future__ import annotations

import copy
from collections.abc import Iterable

import torch
from athrl_spaces import LevelDescription
from torch import Tensor, nn

from athrl_planners.planner import LevelPlan
from athrl_planners.updates import LevelNetworks, UpdateRule


class Level(nn.Module):
    """A level: online networks, target networks, and the averaged networks that are published."""

    def __init__(self, plan: LevelPlan, rule: UpdateRule) -> None:
        super().__init__()
        self.plan, self.rule = plan, rule
        self.online: LevelNetworks = rule.make_networks()
        self.target: LevelNetworks = copy.deepcopy(self.online).requires_grad_(False)
        self.averaged: nn.Module = copy.deepcopy(self.online.deciding).requires_grad_(False)

    @property
    def name(self) -> str:
        """Name of the level."""
        return self.plan.name

    @property
    def actor_parameters(self) -> list[Tensor]:
        """Parameters of the actor; empty if choices follow from the values."""
        actor = [] if self.online.actor is None else list(self.online.actor.parameters())
        return [*actor, *self.rule.parameters()]

    @property
    def held_size(self) -> int:
        """Numbers in the recurrent state for a held decision: the decision and its remaining duration."""
        return 0 if self.plan.every == 1 else len(self.plan.actions) + 1

    def describe(self, trunk_state: int) -> LevelDescription:
        """The description of the level; `trunk_state` numbers of its state belong to its trunk."""
        plan = self.plan
        return LevelDescription(self.name, plan.actions, trunk_state + self.held_size, plan.rewarded)


@torch.no_grad()
def soft_update(changed: Iterable[Tensor], online: Iterable[Tensor], tau: float) -> None:
    """Move target or averaged parameters towards the online ones: tau * online + (1 - tau) * own."""
    torch._foreach_lerp_(list(changed), list(online), tau)
