"""The policy that is published: all levels' averaged trunks and actors, one decision at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import torch
from torch import Tensor, nn

from athrl_planners.level import Level
from athrl_planners.networks import Actor, Trunk, as_pixels

Array = TypeVar("Array")


@dataclass(frozen=True)
class PolicyOutput(Generic[Array]):
    """Each level's decision, float32 [batch, actions] in physical units, and next states [batch, state]."""

    actions: dict[str, Array]
    states: dict[str, Array]


class LevelPolicy(nn.Module):
    """Trunk and actor of one level, and the ranges of its actions."""

    centre: Tensor
    half_range: Tensor

    def __init__(self, trunk: Trunk, actor: Actor, centre: Tensor, half_range: Tensor) -> None:
        super().__init__()
        self.trunk = trunk
        self.actor = actor
        self.register_buffer("centre", centre)
        self.register_buffer("half_range", half_range)

    def forward(
        self, pixels: Tensor, motion: Tensor, state: Tensor, above: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """One decision in physical units, [batch, actions], and the next state; `above` is normalised."""
        features = self.trunk.features(pixels, motion)
        context, state = self.trunk.unroll(features.unsqueeze(0), state)
        return self.centre + self.half_range * torch.tanh(self.actor(context[0], above)), state


class PolicyNetwork(nn.Module):
    """All levels, highest first. It shares its weights with the agent, so it is always the newest average."""

    def __init__(self, levels: Sequence[Level]) -> None:
        super().__init__()
        self.names = tuple(level.name for level in levels)
        self.levels = nn.ModuleDict(
            {
                level.name: LevelPolicy(
                    level.averaged_trunk, level.averaged_actor, level.centre, level.half_range
                )
                for level in levels
            }
        )

    def forward(
        self,
        images: Tensor,
        motion: Tensor,
        states: Mapping[str, Tensor],
        noise: Mapping[str, Tensor],
        forced: Mapping[str, Tensor],
    ) -> PolicyOutput[Tensor]:
        """Decide for images uint8 [batch, height, width, channels] and motion float32 [batch, motion].

        `states` float32 [batch, state] of each level; `noise` and `forced` float32 [batch, actions], physical
        units, of any level but the last: the level's action becomes the forced one where that is not NaN,
        else its own with the noise, within its range; that is what the level below sees and what is returned.
        """
        actions: dict[str, Tensor] = {}
        next_states: dict[str, Tensor] = {}
        above: Tensor | None = None
        pixels = as_pixels(images)
        for name in self.names:
            level = self.levels[name]
            assert isinstance(level, LevelPolicy)
            action, next_states[name] = level(pixels, motion, states[name], above)
            if name in noise:
                action = action + noise[name]
            if name in forced:
                action = torch.where(torch.isnan(forced[name]), action, forced[name])
            above = torch.clamp((action - level.centre) / level.half_range, -1, 1)
            actions[name] = level.centre + level.half_range * above
        return PolicyOutput(actions=actions, states=next_states)
