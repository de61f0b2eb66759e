"""atHRL: an intention planner over a trajectory planner, two recurrent DDPG agents trained together.

The intention planner decides I in [0, 2] (left .. right), the trajectory planner sees I and decides target
speed and waypoint. Losses, with s the context of a level's trunk and Q' the smaller of two target critics:

    TD error of a level    Huber(Q(s, a) - (scale * r + discount * Q'(s', a')))
    trajectory actor       -Q_l(s, I, pi_l(s, I))
    intention actor        -Q_h(s, pi_h(s)) - weight * Q_l(s, pi_h(s), pi_l(s, pi_h(s)))

The last term is how the high level back-propagates both levels' errors (paper, "Hierarchical Off-Policy
Actor-Critic"). Deviations from the paper, each a setting: twin critics, delayed actors and smoothed target
actions (TD3), a penalty on saturated actors, scaled rewards, averaged weights for publication. `networks.py`
tells what actor and critic share.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from athrl_planners.level import Level
from athrl_planners.networks import Trunk
from athrl_planners.policy import PolicyNetwork, PolicyOutput
from athrl_planners.sequence import SequenceBatch
from athrl_planners.settings import ActionRange, ObservationSettings, PlannerSettings
from athrl_planners.training_batch import TrainingBatch, prepare

INTENTION, TRAJECTORY = "intention", "trajectory"
TARGET_NOISE_CLIP = 2.5  # deviations; TD3's .5 at its noise of .2


class AtHRL:
    """Both planners and their training."""

    kind = "athrl"
    levels = (INTENTION, TRAJECTORY)  # highest first

    def __init__(
        self,
        settings: PlannerSettings,
        observation: ObservationSettings,
        actions: Mapping[str, tuple[ActionRange, ...]],
        seed: int,
        device: str | torch.device = "cpu",
    ) -> None:
        """`actions` has what each level decides; equal seeds give equal networks and equal training."""
        if set(actions) != set(self.levels):
            raise ValueError(f"actions are given for {sorted(actions)}; the levels are {list(self.levels)}")
        self.settings = settings
        self.observation = observation
        self.actions = {level: tuple(actions[level]) for level in self.levels}
        self.device = torch.device(device)
        self.updates = 0
        self._noise = torch.Generator(self.device).manual_seed(seed)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            above = 0
            levels = []
            for name in self.levels:
                levels.append(Level(name, settings, observation, self.actions[name], above, self.device))
                above = len(self.actions[name])
        self._high, self._mid = levels
        self.policy = PolicyNetwork(levels)

    @property
    def level_sizes(self) -> dict[str, tuple[int, int]]:
        """Action size and recurrent state size of each level, as the replay wants them."""
        size = self._high.online.trunk.state_size
        return {level: (len(self.actions[level]), size) for level in self.levels}

    @torch.no_grad()
    def act(
        self,
        images: np.ndarray,
        motion: np.ndarray,
        states: Mapping[str, np.ndarray],
        noise: Mapping[str, np.ndarray] | None = None,
        forced: Mapping[str, np.ndarray] | None = None,
    ) -> PolicyOutput[np.ndarray]:
        """Decide for a batch with the averaged actors, as the artefact does; see `PolicyNetwork.forward`."""

        def tensors(arrays: Mapping[str, np.ndarray] | None) -> dict[str, Tensor]:
            return {
                name: torch.as_tensor(value, device=self.device) for name, value in (arrays or {}).items()
            }

        output = self.policy(
            torch.as_tensor(images, device=self.device),
            torch.as_tensor(motion, device=self.device),
            tensors(states),
            tensors(noise),
            tensors(forced),
        )
        return PolicyOutput(
            actions={name: value.cpu().numpy() for name, value in output.actions.items()},
            states={name: value.cpu().numpy() for name, value in output.states.items()},
        )

    def update(self, batch: SequenceBatch, weights: np.ndarray | None = None) -> dict[str, float]:
        """One update of both levels; `weights` float32 [batch] weigh the sequences. Returns its metrics."""
        data = prepare(batch, self.settings.burn_in, weights, self.device)
        metrics: dict[str, float] = {}
        contexts = self._update_critics(data, metrics)
        self.updates += 1
        if self.updates % self.settings.actor_delay == 0:
            self._update_actors(data, contexts, metrics)
        for level in (self._high, self._mid):
            level.follow()
        return metrics

    def _update_critics(self, data: TrainingBatch, metrics: dict[str, float]) -> dict[str, Tensor]:
        """Learn from both levels' TD errors; returns the contexts [n, context] that the actors start from."""
        returns = self._target_returns(data)
        taken = {level.name: level.normalise(data.actions[level.name]) for level in (self._high, self._mid)}
        contexts: dict[str, Tensor] = {}
        for level, above in ((self._high, None), (self._mid, taken[INTENTION])):
            context = _online_context(level.online.trunk, data, data.initial_state[level.name])
            values = [critic(context, above, taken[level.name]) for critic in level.online.critics]
            losses = [functional.huber_loss(value, returns[level.name], reduction="none") for value in values]
            loss = torch.stack(losses).sum(dim=0) @ data.weights
            loss.backward()
            contexts[level.name] = context.detach()
            value = values[0].detach()
            metrics[f"{level.name}/critic_loss"] = float(loss.detach())
            metrics[f"{level.name}/value"] = float(value @ data.weights)
            metrics[f"{level.name}/td_error"] = float((value - returns[level.name]).abs() @ data.weights)
            metrics[f"{level.name}/critic_gradient"] = level.step_critics()
        return contexts

    @torch.no_grad()
    def _target_returns(self, data: TrainingBatch) -> dict[str, Tensor]:
        """Per level, what the critics are to say: float32 [n]. Only a true end cuts the future off."""
        above: Tensor | None = None
        returns: dict[str, Tensor] = {}
        for level in (self._high, self._mid):
            context = _target_context(level.target.trunk, data, data.initial_state[level.name])
            action = self._smoothed(torch.tanh(level.target.actor(context, above)))
            future = level.target.value(context, above, action)
            reward = data.rewards[level.name] * self.settings.reward_scale
            returns[level.name] = reward + self.settings.discount * data.continues * future
            above = action
        return returns

    def _smoothed(self, action: Tensor) -> Tensor:
        """A target action with TD3's clipped noise."""
        if not self.settings.target_noise:
            return action
        noise = torch.randn(action.shape, generator=self._noise, device=self.device)
        noise = noise.clamp(-TARGET_NOISE_CLIP, TARGET_NOISE_CLIP) * self.settings.target_noise
        return (action + noise).clamp(-1, 1)

    def _update_actors(
        self, data: TrainingBatch, contexts: dict[str, Tensor], metrics: dict[str, float]
    ) -> None:
        """Climb the critics. The trunks stay as they are; only the actor that is meant gets a gradient."""
        high, mid = self._high.online, self._mid.online
        intention_raw = high.actor(contexts[INTENTION], None)
        intention = torch.tanh(intention_raw)
        gain = high.critics[0](contexts[INTENTION], None, intention)
        if self.settings.intention_gradient:
            trajectory = torch.tanh(mid.actor(contexts[TRAJECTORY], intention))
            joint = mid.critics[0](contexts[TRAJECTORY], intention, trajectory)
            gain = gain + self.settings.intention_gradient * joint
        self._climb(self._high, gain, intention_raw, data, metrics)

        taken = self._high.normalise(data.actions[INTENTION])
        trajectory_raw = mid.actor(contexts[TRAJECTORY], taken)
        gain = mid.critics[0](contexts[TRAJECTORY], taken, torch.tanh(trajectory_raw))
        self._climb(self._mid, gain, trajectory_raw, data, metrics)

    def _climb(
        self, level: Level, gain: Tensor, raw: Tensor, data: TrainingBatch, metrics: dict[str, float]
    ) -> None:
        """Move an actor up `gain` [n]; a penalty on `raw` [n, actions], before the tanh, holds it back."""
        penalty = raw.square().sum(dim=1)
        loss = (self.settings.saturation_penalty * penalty - gain) @ data.weights
        gradients = torch.autograd.grad(loss, level.actor_parameters)
        for parameter, gradient in zip(level.actor_parameters, gradients, strict=True):
            parameter.grad = gradient
        metrics[f"{level.name}/actor_loss"] = float(loss.detach())
        metrics[f"{level.name}/saturated"] = float((raw.detach().abs() > 2).float().mean())
        metrics[f"{level.name}/actor_gradient"] = level.step_actor()

    def state_dict(self) -> dict[str, Any]:
        """All that is needed to go on bit for bit: tensors and plain values.

        `torch.load(weights_only=True)` reads it back. The tensors are the agent's own; write or copy them
        before the next update.
        """
        return {
            "kind": self.kind,
            "updates": self.updates,
            "noise": self._noise.get_state(),
            "levels": {level.name: level.state_dict() for level in (self._high, self._mid)},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from `state`, bit for bit on the same kind of device.

        Raises ValueError if it is another planner's.
        """
        if state["kind"] != self.kind:
            raise ValueError(
                f"the state is of a planner of kind {state['kind']!r}; this one is {self.kind!r}"
            )
        for level in (self._high, self._mid):
            level.load_state_dict(state["levels"][level.name])
        self.updates = int(state["updates"])
        noise = state["noise"].cpu()
        if noise.shape == self._noise.get_state().shape:
            self._noise.set_state(noise)
        else:  # of another kind of device, whose generator no other one can continue
            self._noise.manual_seed(self._noise.initial_seed() + self.updates)


def _online_context(trunk: Trunk, data: TrainingBatch, state: Tensor) -> Tensor:
    """Contexts of the trained decisions, [n, context]; the burn-in is encoded without a gradient."""
    with torch.no_grad():
        warming = trunk.features(data.pixels[data.warming], data.motion[data.warming])
    trained = trunk.features(data.pixels[data.trained], data.motion[data.trained])
    features = trained.new_zeros(data.time * data.batch, trained.shape[1])
    features = features.index_copy(0, data.warming, warming).index_copy(0, data.trained, trained)
    context, _ = trunk.unroll(features.view(data.time, data.batch, -1), state)
    return context.flatten(0, 1)[data.trained]


def _target_context(trunk: Trunk, data: TrainingBatch, state: Tensor) -> Tensor:
    """Contexts right after the trained decisions, [n, context]."""
    observed = trunk.features(data.pixels[data.observed], data.motion[data.observed])
    features = observed.new_zeros((data.time + 1) * data.batch, observed.shape[1])
    features = features.index_copy(0, data.observed, observed)
    context, _ = trunk.unroll(features.view(data.time + 1, data.batch, -1), state)
    return context.flatten(0, 1)[data.trained + data.batch]
