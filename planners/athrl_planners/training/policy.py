"""The published policy: the averaged networks of all levels, for one decision at a time.

This module is exported as the artefact; there is no second definition.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

import torch
from torch import Tensor, nn

from athrl_planners.networks import Trunk, as_pixels
from athrl_planners.training.level import Level
from athrl_planners.training.state import TrainingState
from athrl_planners.updates import UpdateRule

Array = TypeVar("Array")


@dataclass(frozen=True)
class PolicyOutput(Generic[Array]):
    """Each level's decision, float32 [batch, n] in physical units or indices, and next states [batch, state].

    A level without a state has none here.
    """

    actions: dict[str, Array]
    states: dict[str, Array]


class LevelPolicy(nn.Module):
    """The deciding network of one level."""

    def __init__(self, level: Level) -> None:
        super().__init__()
        self.deciding, self.every = level.averaged, level.plan.every
        self._rules = (level.rule,)  # not a submodule: its parameters are not published

    @property
    def rule(self) -> UpdateRule:
        """The update rule, which converts outputs to a decision."""
        return self._rules[0]

    def forward(
        self, context: Tensor, above: Tensor, held: Tensor, noise: Tensor | None, forced: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """One decision in physical units or an index, [batch, n], and the next state of a held decision.

        `held` [batch, n + 1] is the held decision and for how many more decisions it is held, or has no
        columns; `forced` [batch, n] replaces the decision where it is not NaN, but not a held decision.
        """
        action = self.rule.decide(self.deciding, context, above, noise)
        if forced is not None:
            action = torch.where(torch.isnan(forced), action, forced)
            action = self.rule.decode(self.rule.encode(action).clamp(-1, 1))
        if self.every == 1:
            return action, held
        left = held[:, -1:]
        holds = left > 0.5
        action = torch.where(holds, held[:, :-1], action)
        left = torch.where(holds, left - 1, torch.full_like(left, self.every - 1))
        return action, torch.cat((action, left), dim=1)


class PolicyNetwork(nn.Module):
    """All levels, highest first. It shares the averaged weights with the agent."""

    def __init__(self, state: TrainingState) -> None:
        super().__init__()
        self.trunks = state.averaged_trunks
        self.levels = nn.ModuleDict({level.name: LevelPolicy(level) for level in state.levels})
        self._trunk_of = {level.name: state.trunk_of(level.name) for level in state.levels}

    def forward(
        self,
        images: Tensor,
        motion: Tensor,
        states: Mapping[str, Tensor],
        noise: Mapping[str, Tensor],
        forced: Mapping[str, Tensor],
    ) -> PolicyOutput[Tensor]:
        """Decide for images uint8 [batch, height, width, channels] and motion float32 [batch, motion].

        `states` float32 [batch, state] of each level that has one; `noise` and `forced` float32 [batch, n] of
        any level: noise in physical units (standard normal for a stochastic policy), forced in physical units
        or an index, NaN where the level is free. A level sees the outputs of the levels above.
        """
        pixels = as_pixels(images)
        contexts: dict[str, Tensor] = {}
        actions: dict[str, Tensor] = {}
        next_states: dict[str, Tensor] = {}
        seen: list[Tensor] = []
        for name, level in self.levels.items():
            assert isinstance(level, LevelPolicy)
            state, remembered = states.get(name), []
            size = 0
            if self._trunk_of[name] == name:
                trunk = self.trunks[name]
                assert isinstance(trunk, Trunk)
                size = trunk.state_size
                own = None if not size or state is None else state[:, :size]
                contexts[name], own = trunk.step(trunk.features(pixels, motion), own)
                remembered += [] if own is None else [own]
            context = contexts[self._trunk_of[name]]
            held = context[:, :0] if state is None else state[:, size:]
            above = torch.cat(seen, dim=1) if seen else context[:, :0]
            actions[name], held = level(context, above, held, noise.get(name), forced.get(name))
            seen.append(level.rule.encode(actions[name]))
            remembered += [held] if level.every > 1 else []
            if remembered:
                next_states[name] = torch.cat(remembered, dim=1)
        return PolicyOutput(actions=actions, states=next_states)
