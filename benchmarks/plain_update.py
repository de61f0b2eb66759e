"""The update of the default planner as one would write it in plain torch, for `benchmarks.updates`.

The same mathematics as `athrl_planners` for atHRL with TD3 and distributional critics, by whole sequences
with an LSTM or by single decisions without: one trunk for both levels, one for the targets, averaged actors.
Eager float32, `torch.optim.Adam` as it comes, loops over parameters, and every frame of a sequence encoded,
padding or not. It shares no code with what it is compared to; a test holds both to equal losses.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable

import numpy as np
import torch
from athrl_planners import Agent, Batch, SequenceBatch, TransitionBatch
from torch import Tensor, nn
from torch.nn import functional

LEVELS = ("intention", "trajectory")


class Trunk(nn.Module):
    """Convolutions, a dense layer that joins image and motion, and optionally an LSTM."""

    def __init__(self, image_size: int, channels: int, motion: int, hidden: int, units: int) -> None:
        super().__init__()
        size = image_size
        layers: list[nn.Module] = []
        for width in (16, 32, 64):
            layers += [nn.Conv2d(channels, width, 3, 2, 1), nn.ReLU()]
            channels, size = width, (size + 1) // 2
        features = channels * size * size
        self.encoder = nn.Sequential(*layers, nn.Flatten(), nn.LayerNorm(features))
        self.dense = nn.Sequential(nn.Linear(features + motion, hidden), nn.LayerNorm(hidden), nn.ReLU())
        self.memory = nn.LSTM(hidden, units) if units else None
        self.context_size = hidden + units

    def features(self, images: Tensor, motion: Tensor) -> Tensor:
        """uint8 [n, h, w, channels], [n, motion] -> [n, hidden]."""
        pixels = images.permute(0, 3, 1, 2).contiguous().float() / 255
        return self.dense(torch.cat([self.encoder(pixels), motion], 1))

    def unroll(self, images: Tensor, motion: Tensor, state: Tensor) -> Tensor:
        """uint8 [time, batch, ...], the state before the first frame -> contexts [time, batch, context]."""
        assert self.memory is not None
        features = self.features(images.flatten(0, 1), motion.flatten(0, 1)).unflatten(0, images.shape[:2])
        output, cell = state[None].chunk(2, 2)
        remembered, _ = self.memory(features, (output.contiguous(), cell.contiguous()))
        return torch.cat([features, remembered], 2)


def head(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    """Two hidden layers."""
    return nn.Sequential(
        nn.Linear(inputs, hidden),
        nn.LayerNorm(hidden),
        nn.ReLU(),
        nn.Linear(hidden, hidden),
        nn.ReLU(),
        nn.Linear(hidden, outputs),
    )


class Level(nn.Module):
    """An actor and two critics."""

    def __init__(self, context: int, above: int, actions: int, hidden: int, atoms: int) -> None:
        super().__init__()
        self.actor = head(context + above, hidden, actions)
        self.critics = nn.ModuleList(head(context + above + actions, hidden, atoms) for _ in range(2))

    def decide(self, context: Tensor, above: Tensor) -> Tensor:
        """What the actor puts out before its tanh."""
        return self.actor(torch.cat([context, above], 1))

    def ask(self, critic: int, context: Tensor, above: Tensor, action: Tensor) -> Tensor:
        """A critic's logits."""
        return self.critics[critic](torch.cat([context, above, action], 1))


class Networks(nn.Module):
    """A trunk and both levels."""

    def __init__(self, agent: Agent) -> None:
        super().__init__()
        settings, seen = agent.settings, agent.description.observation
        units = settings.recurrent_features if agent.has_memory else 0
        self.trunk = Trunk(
            seen.image_size, len(seen.channels), seen.motion_size, settings.hidden_features, units
        )
        context, atoms = self.trunk.context_size, settings.atoms
        self.intention = Level(context, 0, 1, settings.intention_features, atoms)
        self.trajectory = Level(context, 1, 2, settings.head_features, atoms)

    def level(self, name: str) -> Level:
        """By its name."""
        found = getattr(self, name)
        assert isinstance(found, Level)
        return found


class PlainUpdate:
    """Trains from where a fresh agent is.

    Args:
        agent: of the planner athrl with its default update rule and critics, before its first update.
    """

    def __init__(self, agent: Agent) -> None:
        self.settings, self.device = agent.settings, agent.device
        self.networks = Networks(agent).to(self.device)
        self._take_weights(agent)
        self.target = copy.deepcopy(self.networks)
        self.average = copy.deepcopy(self.networks)
        networks = self.networks
        self.critic_parameters = [
            *networks.trunk.parameters(),
            *networks.intention.critics.parameters(),
            *networks.trajectory.critics.parameters(),
        ]
        self.actor_parameters = [
            *networks.intention.actor.parameters(),
            *networks.trajectory.actor.parameters(),
        ]
        rate = self.settings.learning_rate
        self.critic_optimiser = torch.optim.Adam(self.critic_parameters, lr=rate)
        self.actor_optimiser = torch.optim.Adam(self.actor_parameters, lr=rate)
        self.random = torch.Generator(self.device)
        self.random.set_state(agent.state.noise.generators[0].get_state())
        low, high = self.settings.value_min, self.settings.value_max
        self.support = torch.linspace(low, high, self.settings.atoms, device=self.device)
        levels = agent.description.levels
        self.centre = {level.name: self._of([action.centre for action in level.actions]) for level in levels}
        self.half = {
            level.name: self._of([action.half_range for action in level.actions]) for level in levels
        }
        self.updates = 0

    def update(self, batch: Batch, progress: float = 0.0) -> dict[str, float]:
        """Train on a batch; the losses by the names that the agent has for them."""
        rate = self.settings.learning_rate * (1 - (1 - self.settings.final_learning_rate) * progress)
        for optimiser in (self.critic_optimiser, self.actor_optimiser):
            for group in optimiser.param_groups:
                group["lr"] = rate
        data = Decisions(self, batch)
        contexts, losses = self._critic_losses(data)
        self.updates += 1
        climbing = self.updates % self.settings.td3_actor_delay == 0
        if climbing:  # the critics as they are before their step
            losses |= self._actor_gradients(data, contexts.detach())
        self._step_critics(losses)
        if climbing:
            nn.utils.clip_grad_norm_(self.actor_parameters, self.settings.gradient_norm)
            self.actor_optimiser.step()
        self._follow()
        return {name: float(loss.detach()) for name, loss in losses.items()}

    def _critic_losses(self, data: Decisions) -> tuple[Tensor, dict[str, Tensor]]:
        with torch.no_grad():
            targets = self._targets(data)
        contexts = data.current(self.networks.trunk)
        losses = {}
        above = contexts[:, :0]
        for name in LEVELS:
            level, taken = self.networks.level(name), data.taken[name]
            if name == "intention":
                targets[name] = self._worth(contexts.detach(), taken)
            each = [
                -(targets[name] * functional.log_softmax(level.ask(critic, contexts, above, taken), 1)).sum(1)
                for critic in range(2)
            ]
            losses[f"{name}/critic_loss"] = ((each[0] + each[1]) * data.weights).sum()
            above = torch.cat([above, taken], 1)
        return contexts, losses

    def _step_critics(self, losses: dict[str, Tensor]) -> None:
        self.critic_optimiser.zero_grad()
        sum(loss for name, loss in losses.items() if name.endswith("critic_loss")).backward()
        nn.utils.clip_grad_norm_(self.critic_parameters, self.settings.gradient_norm)
        self.critic_optimiser.step()

    @torch.no_grad()
    def _worth(self, contexts: Tensor, intention: Tensor) -> Tensor:
        """The trajectory critics' value of the trajectory planner's decision for an intention."""
        level = self.networks.trajectory
        action = self._smoothed(self._reached(level.decide(contexts, intention)))
        return self._smaller(level, contexts, intention, action).softmax(1)

    def _reached(self, raw: Tensor) -> Tensor:
        return (self.settings.action_reach * torch.tanh(raw)).clamp(-1, 1)

    def _smoothed(self, action: Tensor) -> Tensor:
        noise = torch.randn(action.shape, generator=self.random, device=self.device).clamp(-2.5, 2.5)
        return (action + self.settings.td3_target_noise * noise).clamp(-1, 1)

    def _smaller(self, level: Level, contexts: Tensor, above: Tensor, action: Tensor) -> Tensor:
        first, second = (level.ask(critic, contexts, above, action) for critic in range(2))
        return torch.where((self._mean(first) < self._mean(second))[:, None], first, second)

    def _targets(self, data: Decisions) -> dict[str, Tensor]:
        contexts = data.next(self.target.trunk)
        targets = {}
        above = contexts[:, :0]
        for name in LEVELS:
            level = self.target.level(name)
            action = self._smoothed(self._reached(level.decide(contexts, above)))
            if name == "trajectory":  # the value of the intention is computed for the same step
                smaller = self._smaller(level, contexts, above, action)
                targets[name] = self._projected(data.reward[name], data.discount, smaller.softmax(1))
            above = torch.cat([above, action], 1)
        return targets

    def _actor_gradients(self, data: Decisions, contexts: Tensor) -> dict[str, Tensor]:
        losses = {}
        above = contexts[:, :0]
        for number, name in enumerate(LEVELS):
            level = self.networks.level(name)
            raw = level.decide(contexts, above)
            action = self._reached(raw)
            gain = self._mean(level.ask(0, contexts, above, action))
            gain = gain - self.settings.saturation_penalty * raw.square().sum(1)
            if number == 0:
                below = self.networks.trajectory
                below.requires_grad_(False)  # it only learns from its own value
                followed = self._reached(below.decide(contexts, action))
                joint = self._mean(below.ask(0, contexts, action, followed))
                below.requires_grad_(True)
                gain = gain + self.settings.intention_gradient * joint
            losses[f"{name}/actor_loss"] = -(gain * data.weights).sum()
            above = torch.cat([above, data.taken[name]], 1)
        self.actor_optimiser.zero_grad()
        gradients = torch.autograd.grad(sum(losses.values()), self.actor_parameters)
        for parameter, gradient in zip(self.actor_parameters, gradients, strict=True):
            parameter.grad = gradient
        return losses

    @torch.no_grad()
    def _follow(self) -> None:
        for followers, share in ((self.target, self.settings.tau), (self.average, self._average_share)):
            for follower, leader in zip(followers.parameters(), self.networks.parameters(), strict=True):
                follower.mul_(1 - share).add_(share * leader)

    @property
    def _average_share(self) -> float:
        return 1 - self.settings.average_decay

    def _mean(self, logits: Tensor) -> Tensor:
        return (logits.softmax(1) * self.support).sum(1)

    def _projected(self, reward: Tensor, discount: Tensor, probabilities: Tensor) -> Tensor:
        low, high, atoms = self.settings.value_min, self.settings.value_max, self.settings.atoms
        shifted = (reward[:, None] + discount[:, None] * self.support).clamp(low, high)
        place = (shifted - low) / ((high - low) / (atoms - 1))
        below, above = place.floor().long(), place.ceil().long()
        share = place - below
        target = torch.zeros_like(probabilities)
        target.scatter_add_(1, below, probabilities * (1 - share))
        target.scatter_add_(1, above, probabilities * share)
        return target

    def _take_weights(self, agent: Agent) -> None:
        state = agent.state
        (_, trunk), *others = state.online_trunks
        assert not others, "both levels have one trunk"
        pairs: list[tuple[Iterable[Tensor], Iterable[Tensor]]] = [
            (self.networks.trunk.parameters(), trunk.parameters())
        ]
        for level in state.levels:
            own = self.networks.level(level.name)
            assert level.online.actor is not None
            pairs.append((own.actor.parameters(), level.online.actor.parameters()))
            pairs.append((own.critics.parameters(), level.online.critics.parameters()))
        with torch.no_grad():
            for mine, theirs in pairs:
                for parameter, weights in zip(mine, theirs, strict=True):
                    assert parameter.shape == weights.shape
                    parameter.copy_(weights)

    def _of(self, values: object) -> Tensor:
        return torch.as_tensor(np.asarray(values, np.float32), device=self.device)


class Decisions:
    """What is trained of a batch, the n decisions one behind the other."""

    def __init__(self, update: PlainUpdate, batch: Batch) -> None:
        self._device = update.device
        if isinstance(batch, TransitionBatch):
            self._rows = None
            ahead, ended = batch.steps[0], batch.terminated[0]
            rewards, actions, weights = batch.rewards, batch.actions, batch.weights
            self._images, self._motion = self._tensor(batch.images), self._tensor(batch.motion)
        else:
            ahead, ended, rewards, actions, weights = self._of_sequences(update, batch)
        settings = update.settings
        powers = settings.discount ** np.arange(settings.n_step)
        counted = np.arange(settings.n_step) < ahead[:, None]
        penalty = ended * settings.end_penalty * settings.discount ** (ahead - 1)
        self.reward = {
            name: self._numbers(settings.reward_scale * (rewards[name] * counted) @ powers - penalty)
            for name in LEVELS
        }
        self.discount = self._numbers(np.where(ended, 0, settings.discount**ahead))
        self.weights = self._numbers(weights / weights.sum())
        self.taken = {
            name: (self._tensor(actions[name]) - update.centre[name]) / update.half[name] for name in LEVELS
        }

    def current(self, trunk: Trunk) -> Tensor:
        """Contexts of the decisions, [n, context]."""
        if self._rows is None:
            return trunk.features(self._images[0], self._motion[0])
        step, row, _ = self._rows
        return trunk.unroll(self._images[:-1], self._motion[:-1], self._state)[step, row]

    def next(self, trunk: Trunk) -> Tensor:
        """Contexts where their targets look, [n, context]."""
        if self._rows is None:
            return trunk.features(self._images[1], self._motion[1])
        _, row, later = self._rows
        return trunk.unroll(self._images, self._motion, self._state)[later, row]

    def _of_sequences(
        self, update: PlainUpdate, batch: SequenceBatch
    ) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray], np.ndarray]:
        """Decisions of whole sequences, step by step; without burn-in."""
        time = batch.images.shape[1] - 1
        step, row = np.nonzero(np.arange(time)[:, None] < batch.length)
        ahead = np.minimum(update.settings.n_step, batch.length[row] - step)
        ended = batch.terminated[row] & (step + ahead == batch.length[row])
        window = np.minimum(step[:, None] + np.arange(update.settings.n_step), time - 1)
        self._rows = tuple(self._tensor(places) for places in (step, row, step + ahead))
        self._images = self._tensor(batch.images.swapaxes(0, 1))
        self._motion = self._tensor(batch.motion.swapaxes(0, 1))
        self._state = self._tensor(batch.initial_state[LEVELS[0]])
        rewards = {name: batch.rewards[name][row[:, None], window] for name in LEVELS}
        actions = {name: batch.actions[name][row, step] for name in LEVELS}
        return ahead, ended, rewards, actions, batch.weights[row]

    def _tensor(self, values: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(self._device)

    def _numbers(self, values: np.ndarray) -> Tensor:
        return self._tensor(values.astype(np.float32))
