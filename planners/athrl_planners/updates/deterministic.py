"""DDPG (Lillicrap et al. 2015) and TD3 (Fujimoto et al. 2018), which is DDPG with three changes.

    target      r + discount * min_i Q_i'(s', pi'(s') + clipped noise)
    actor       maximise  Q_1(s, pi(s)) - saturation_penalty * |output before the tanh|^2
    decision    pi(s) = min(max(action_reach * tanh(output), -1), 1)

DDPG has one critic, no target policy smoothing and no policy delay. The penalty is an addition of this
project: without it the tanh saturates within some hundred updates. With it the ends of a range are never
reached, and a vehicle that cannot decide a speed of 0 creeps into the one ahead; so the reach is another
addition.
"""

from __future__ import annotations

import torch
from athrl_spaces import Continuous
from torch import Tensor, nn

from athrl_planners.networks.heads import Actor, Critic
from athrl_planners.updates.rule import LevelNetworks, Objective, Step, UpdateRule, centre_and_half_range

NOISE_CLIP = 2.5
"""Deviations at which the noise of target policy smoothing is clipped; in TD3 0.5 for a noise of 0.2."""


class ContinuousRule(UpdateRule):
    """Base of the rules for continuous actions."""

    centre: Tensor
    half_range: Tensor
    stochastic = False

    def set_up(self) -> None:
        """Check that the level decides numbers; keep their ranges."""
        plan = self.plan
        if not all(isinstance(action, Continuous) for action in plan.actions):
            raise ValueError(f"level {plan.name} learns by {plan.update_rule} and decides a choice: use dqn")
        self.encoded_size = len(plan.actions)
        centre, half_range = centre_and_half_range(plan.actions)
        self.register_buffer("centre", centre, persistent=False)
        self.register_buffer("half_range", half_range, persistent=False)

    def make_networks(self) -> LevelNetworks:
        """An actor and critics."""
        inputs, hidden = self.context_size + self.above_size, self.head_features
        actor = Actor(inputs, hidden, self.encoded_size, self.stochastic)
        return LevelNetworks(
            actor,
            [
                Critic(inputs + self.encoded_size, hidden, self.values.outputs)
                for _ in range(self.settings.critics)
            ],
        )

    def encode(self, actions: Tensor) -> Tensor:
        """Physical units -> [-1, 1]."""
        return (actions - self.centre) / self.half_range

    def decode(self, encoded: Tensor) -> Tensor:
        """[-1, 1] -> physical units."""
        return self.centre + self.half_range * encoded

    def value_of(self, critic: nn.Module, context: Tensor, above: Tensor, taken: Tensor) -> Tensor:
        """Outputs of a critic for decisions: [n, outputs]."""
        return critic(context, above, taken).float()


class DeterministicRule(ContinuousRule):
    """DDPG and TD3."""

    def set_up(self) -> None:
        """Delay and smoothing are TD3's alone."""
        super().set_up()
        smoothed = self.plan.update_rule == "td3"
        self.actor_delay = self.settings.td3_actor_delay if smoothed else 1
        self._target_noise = self.settings.td3_target_noise if smoothed else 0.0

    def decide(self, deciding: nn.Module, context: Tensor, above: Tensor, noise: Tensor | None) -> Tensor:
        """The actor's action with noise in physical units, within its range."""
        action = self.decode(self._reach(deciding(context, above)))
        if noise is not None:
            action = action + noise
        return self.decode(self.encode(action).clamp(-1, 1))

    def next_step(
        self, target: LevelNetworks, online: LevelNetworks, contexts: tuple[Tensor, Tensor], above: Tensor
    ) -> Step:
        """The target actor's action, with clipped noise in TD3, and the target critics' value."""
        assert target.actor is not None
        context = contexts[0]
        action = self._reach(target.actor(context, above).float())
        if self._target_noise:
            noise = self.noise.normal_like(action).clamp(-NOISE_CLIP, NOISE_CLIP) * self._target_noise
            action = (action + noise).clamp(-1, 1)
        return Step(action, lambda: self.target_output(target, context, above, action), None)

    def objective(
        self, networks: LevelNetworks, context: Tensor, above: Tensor, penalised: bool = True
    ) -> Objective:
        """The first critic's value of the actor's action, minus the penalty on saturation."""
        assert networks.actor is not None
        raw = networks.actor(context, above).float()
        action = self._reach(raw)
        value = self.values.mean(self.value_of(networks.critics[0], context, above, action))
        penalty = self.settings.saturation_penalty * raw.square().sum(dim=1) if penalised else 0.0
        return Objective(value - penalty, action, raw)

    def _reach(self, raw: Tensor) -> Tensor:
        """Action of an actor's output: [n, actions] in [-1, 1]."""
        action = torch.tanh(raw)
        reach = self.settings.action_reach
        return action if reach == 1 else (action * reach).clamp(-1, 1)
