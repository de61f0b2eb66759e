"""Everything that training changes: networks, targets, averages, optimisers, counters, random states.

This is the complete content of a planner in a checkpoint.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import torch
from athrl_spaces import Limits, Observation
from torch import Tensor, nn

from athrl_planners.networks import Trunk
from athrl_planners.planner import LevelPlan, Planner
from athrl_planners.replay.random_state import restore_random, to_words
from athrl_planners.settings import PlannerSettings
from athrl_planners.training.level import Level, soft_update
from athrl_planners.updates import Values, make_rule, make_values
from athrl_planners.updates.adam import Adam
from athrl_planners.updates.noise import NoiseSource


class TrainingState:
    """A planner's networks and the rest of its training state.

    Attributes:
        kind: of the planner.
        updates: number of updates so far.
        levels: highest first.
        values: what critics predict.
        noise: source of noise in updates.
        mirroring: generator that selects the mirrored transitions.
    """

    def __init__(
        self,
        planner: type[Planner],
        settings: PlannerSettings,
        observation: Observation,
        limits: Limits,
        seed: int,
        device: torch.device,
        parts: int = 1,
    ) -> None:
        """Make new networks, equal for equal seeds; `parts` of an update are computed in parallel."""
        self.kind, self.settings, self.updates = planner.kind, settings, 0
        self.noise = NoiseSource(seed, device, parts)
        self.mirroring = np.random.Generator(np.random.PCG64(seed))
        self.values: Values = make_values(settings).to(device)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            plans = planner.levels(settings, limits)
            _require_levels_below(plans)
            shared = settings.shared_trunk and len({plan.view for plan in plans}) == 1
            self._trunk_of = {plan.name: plans[0].name if shared else plan.name for plan in plans}
            self._trunks = self._make_trunks(plans, observation)
            self.levels = self._make_levels(plans)
        self._targets, self._averages = (copy.deepcopy(self._trunks).requires_grad_(False) for _ in range(2))
        self.networks = nn.ModuleDict(
            {
                "trunks": self._trunks,
                "target_trunks": self._targets,
                "averaged_trunks": self._averages,
                "levels": nn.ModuleDict({level.name: level for level in self.levels}),
            }
        )
        self.networks.to(device).to(memory_format=torch.channels_last)
        for module in self.networks.modules():
            if isinstance(module, nn.RNNBase):  # copies are not in one piece, as cuDNN wants its weights
                module.flatten_parameters()
        critics = (parameter for level in self.levels for parameter in level.online.critics.parameters())
        self.critic_parameters: list[Tensor] = [*self._trunks.parameters(), *critics]
        self.actor_parameters: list[Tensor] = [
            parameter for level in self.levels for parameter in level.actor_parameters
        ]
        self.critic_optimiser = Adam(self.critic_parameters, settings.learning_rate)
        self.actor_optimiser = Adam(self.actor_parameters, settings.learning_rate)

    def _make_trunks(self, plans: tuple[LevelPlan, ...], observation: Observation) -> nn.ModuleDict:
        views = {self._trunk_of[plan.name]: plan.view for plan in reversed(plans)}
        return nn.ModuleDict(
            {
                plan.name: Trunk(self.settings, observation, views[plan.name])
                for plan in plans
                if plan.name in views
            }
        )

    def _make_levels(self, plans: tuple[LevelPlan, ...]) -> tuple[Level, ...]:
        levels = []
        above = 0
        for plan in plans:
            sizes = (self.trunk(plan.name).context_size, above)
            rule = make_rule(plan.update_rule)(plan, self.settings, self.values, sizes, self.noise)
            levels.append(Level(plan, rule))
            above += rule.encoded_size
        return tuple(levels)

    def trunk_of(self, level: str) -> str:
        """Name of the level whose trunk a level uses: its own, or the highest level."""
        return self._trunk_of[level]

    def trunk(self, level: str) -> Trunk:
        """The trunk that a level uses."""
        trunk = self._trunks[self._trunk_of[level]]
        assert isinstance(trunk, Trunk)
        return trunk

    def trunk_state_size(self, level: str) -> int:
        """Numbers of a trunk in a level's recurrent state; only the trunk's own level stores them."""
        return self.trunk(level).state_size if self._trunk_of[level] == level else 0

    @property
    def online_trunks(self) -> Iterator[tuple[str, Trunk]]:
        """The trained trunks by name."""
        return _trunks(self._trunks)

    @property
    def target_trunks(self) -> Iterator[tuple[str, Trunk]]:
        """The target trunks by name."""
        return _trunks(self._targets)

    @property
    def averaged_trunks(self) -> nn.ModuleDict:
        """The averaged trunks, which are published."""
        return self._averages

    def update_targets(self) -> None:
        """Soft update of target and averaged networks."""
        tau, share = self.settings.tau, 1 - self.settings.average_decay
        soft_update(self._targets.parameters(), self._trunks.parameters(), tau)
        soft_update(self._averages.parameters(), self._trunks.parameters(), share)
        for level in self.levels:
            soft_update(level.target.parameters(), level.online.parameters(), tau)
            soft_update(level.averaged.parameters(), level.online.deciding.parameters(), share)

    def state_dict(self) -> dict[str, Any]:
        """The state that training needs to continue bit for bit: tensors and plain values.

        `torch.load(weights_only=True)` can read it. The tensors are not copied; write or copy them before the
        next update.
        """
        return {
            "kind": self.kind,
            "updates": self.updates,
            "noise": self.noise.state(),
            "mirroring": to_words(self.mirroring),
            "networks": self.networks.state_dict(),
            "critic_optimiser": self.critic_optimiser.state_dict(),
            "actor_optimiser": self.actor_optimiser.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from `state`, bit for bit on the same kind of device.

        Raises:
            ValueError: it belongs to another planner or has other sizes; nothing has been changed.
        """
        missing = set(self.state_dict()) - set(state)
        if missing:
            raise ValueError(f"the planner's state lacks {min(missing)!r}; it is of another release")
        if state["kind"] != self.kind:
            raise ValueError(
                f"the state is of a planner of kind {state['kind']!r}; this one is {self.kind!r}"
            )
        _require_equal_shapes(state["networks"], self.networks.state_dict())
        self.critic_optimiser.require_fitting(state["critic_optimiser"])
        self.actor_optimiser.require_fitting(state["actor_optimiser"])
        restore_random(np.random.Generator(np.random.PCG64()), state["mirroring"])
        self.critic_optimiser.load_state_dict(state["critic_optimiser"])
        self.actor_optimiser.load_state_dict(state["actor_optimiser"])
        self.networks.load_state_dict(state["networks"])
        self.updates = int(state["updates"])
        restore_random(self.mirroring, state["mirroring"])
        self.noise.load_state(state["noise"], self.updates)


def _trunks(modules: nn.ModuleDict) -> Iterator[tuple[str, Trunk]]:
    for name, trunk in modules.items():
        assert isinstance(trunk, Trunk)
        yield name, trunk


def _require_levels_below(plans: tuple[LevelPlan, ...]) -> None:
    for number, plan in enumerate(plans):
        below = [next_plan.update_rule for next_plan in plans[number + 1 : number + 2]]
        paid = [next_plan.rewarded for next_plan in plans[number + 1 : number + 2]]
        if plan.value_from == "below" and paid != [plan.rewarded]:
            raise ValueError(
                f"level {plan.name} learns values from below, where there is no level with the same reward"
            )
        if plan.gradient_from_below and below in ([], ["dqn"]):
            raise ValueError(
                f"level {plan.name} takes a gradient from below, where there is no level that decides numbers"
            )


def _require_equal_shapes(found: Mapping[str, Tensor], wanted: Mapping[str, Tensor]) -> None:
    missing, unknown = sorted(set(wanted) - set(found)), sorted(set(found) - set(wanted))
    if missing or unknown:
        what = f"lacks {missing[0]}" if missing else f"has {unknown[0]}, which this planner does not have"
        raise ValueError(f"the planner's state {what}")
    for name, tensor in wanted.items():
        if found[name].shape != tensor.shape:
            raise ValueError(f"{name} has shape {list(found[name].shape)}; it should be {list(tensor.shape)}")
