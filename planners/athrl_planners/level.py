"""One level of the hierarchy: its online, target and averaged networks and its optimisers (DDPG, TD3)."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor, nn

from athrl_planners.adam import Adam
from athrl_planners.networks import Actor, Critic, Trunk
from athrl_planners.settings import ActionRange, ObservationSettings, PlannerSettings


class LevelNetworks(nn.Module):
    """The networks of a level; there is an online and a target copy."""

    def __init__(
        self, settings: PlannerSettings, observation: ObservationSettings, actions: int, above: int
    ) -> None:
        """`actions` numbers are decided here, `above` numbers by the level above."""
        super().__init__()
        hidden = settings.hidden_features
        self.trunk = Trunk(observation, hidden, settings.recurrent_features)
        inputs = self.trunk.context_size + above
        self.actor = Actor(inputs, hidden, actions)
        self.critics = nn.ModuleList(
            Critic(inputs + actions, hidden) for _ in range(1 + settings.twin_critics)
        )

    def value(self, context: Tensor, above: Tensor | None, action: Tensor) -> Tensor:
        """The smallest of the critics' values: [n]."""
        values = [critic(context, above, action) for critic in self.critics]
        return torch.stack(values).amin(dim=0)


class Level:
    """A level's agent. Its trunk and critics learn from the TD error, its actor from the critic."""

    def __init__(
        self,
        name: str,
        settings: PlannerSettings,
        observation: ObservationSettings,
        actions: tuple[ActionRange, ...],
        above: int,
        device: torch.device,
    ) -> None:
        self.name = name
        self.actions = actions
        self._settings = settings
        self.online = LevelNetworks(settings, observation, len(actions), above).to(device)
        self.target = copy.deepcopy(self.online).requires_grad_(False)
        # What is published: the averaged trunk and actor. It has no critics.
        self.averaged_trunk = copy.deepcopy(self.online.trunk).requires_grad_(False)
        self.averaged_actor = copy.deepcopy(self.online.actor).requires_grad_(False)
        self.centre = torch.tensor([action.centre for action in actions], device=device)
        self.half_range = torch.tensor([action.half_range for action in actions], device=device)
        self.critic_parameters = [*self.online.trunk.parameters(), *self.online.critics.parameters()]
        self.actor_parameters = list(self.online.actor.parameters())
        self._critic_optimiser = Adam(self.critic_parameters, settings.learning_rate)
        self._actor_optimiser = Adam(self.actor_parameters, settings.learning_rate)

    def normalise(self, actions: Tensor) -> Tensor:
        """Physical units -> [-1, 1]."""
        return (actions - self.centre) / self.half_range

    def step_critics(self) -> float:
        """Apply the gradients that trunk and critics have; returns their norm before clipping."""
        return _step(self._critic_optimiser, self.critic_parameters, self._settings.gradient_norm)

    def step_actor(self) -> float:
        """Apply the gradients that the actor has; returns their norm before clipping."""
        return _step(self._actor_optimiser, self.actor_parameters, self._settings.gradient_norm)

    def follow(self) -> None:
        """Move the target and the averaged networks towards the online ones."""
        _move(self.target, self.online, self._settings.soft_target)
        share = 1 - self._settings.average_decay
        _move(self.averaged_trunk, self.online.trunk, share)
        _move(self.averaged_actor, self.online.actor, share)

    def state_dict(self) -> dict[str, Any]:
        """All that this level must keep to go on exactly where it was."""
        return {name: part.state_dict() for name, part in self._parts().items()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from `state`; raises RuntimeError or ValueError if it is of another shape."""
        for name, part in self._parts().items():
            part.load_state_dict(state[name])

    def _parts(self) -> dict[str, nn.Module | Adam]:
        return {
            "online": self.online,
            "target": self.target,
            "averaged_trunk": self.averaged_trunk,
            "averaged_actor": self.averaged_actor,
            "critic_optimiser": self._critic_optimiser,
            "actor_optimiser": self._actor_optimiser,
        }


def _step(optimiser: Adam, parameters: Iterable[Tensor], norm: float) -> float:
    total = torch.nn.utils.clip_grad_norm_(parameters, norm)
    optimiser.step()
    return float(total)


@torch.no_grad()
def _move(followers: nn.Module, leaders: nn.Module, share: float) -> None:
    for follower, leader in zip(followers.parameters(), leaders.parameters(), strict=True):
        follower.lerp_(leader, share)
