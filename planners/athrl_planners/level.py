"""One level of a planner under training: its rule and its online, target and averaged heads."""

from __future__ import annotations

import copy
from collections.abc import Iterable

import torch
from athrl_spaces import LevelDescription
from torch import Tensor, nn

from athrl_planners.planner import LevelPlan
from athrl_planners.updates import LevelNetworks, UpdateRule


class Level(nn.Module):
    """A level: what is trained, the target that it is trained towards, and the average that is published."""

    def __init__(self, plan: LevelPlan, rule: UpdateRule) -> None:
        super().__init__()
        self.plan, self.rule = plan, rule
        self.online: LevelNetworks = rule.make_networks()
        self.target: LevelNetworks = copy.deepcopy(self.online).requires_grad_(False)
        self.averaged: nn.Module = copy.deepcopy(self.online.deciding).requires_grad_(False)

    @property
    def name(self) -> str:
        """Of the level."""
        return self.plan.name

    @property
    def actor_parameters(self) -> list[Tensor]:
        """What climbs the critics; empty where a choice follows from the values."""
        actor = [] if self.online.actor is None else list(self.online.actor.parameters())
        return [*actor, *self.rule.parameters()]

    @property
    def held_size(self) -> int:
        """Numbers in the recurrent state for a decision that is held: it, and for how long still."""
        return 0 if self.plan.every == 1 else len(self.plan.actions) + 1

    def describe(self, trunk_state: int) -> LevelDescription:
        """The level as an artefact tells of it; `trunk_state` numbers of its state are its trunk's."""
        plan = self.plan
        return LevelDescription(self.name, plan.actions, trunk_state + self.held_size, plan.rewarded)


@torch.no_grad()
def soft_update(changed: Iterable[Tensor], online: Iterable[Tensor], tau: float) -> None:
    """Move target or averaged parameters towards the online ones: tau * online + (1 - tau) * own."""
    torch._foreach_lerp_(list(changed), list(online), tau)
