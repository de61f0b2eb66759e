"""What an update minimises: the critics' loss and the actors' losses of a planner's levels.

For levels from the highest down, with s what a level's trunk makes of what is seen, `above` what the levels
above have decided, and Q', pi' the target networks:

    target     y = r + discount^n * Q'(s', above', pi'(s', above'))        n steps later
    critics    minimise the loss of Q(s, above, a) against y; the trunk learns from this alone
    actors     maximise Q(s, above, pi(s, above)), and, for a level with `gradient_from_below`, the next
               level's Q(s, pi(s), pi_below(s, pi(s))) as well (paper, "Hierarchical Off-Policy Actor-Critic")
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from athrl_planners.level import Level
from athrl_planners.training_batch import TrainingBatch
from athrl_planners.training_state import TrainingState

Contexts = Mapping[str, Tensor]
"""By the trunk's name: [n, context], or [horizons, n, context]."""


class CriticLoss(NamedTuple):
    """The critics' loss, and what actors and the replay need of it."""

    loss: Tensor
    """float32 []"""
    contexts: dict[str, Tensor]
    """By the trunk's name float32 [n, context], without gradient."""
    errors: Tensor
    """float32 [pieces], the largest absolute error of each piece of the batch."""
    metrics: dict[str, Tensor]
    """float32 [] each."""


def critic_loss(state: TrainingState, data: TrainingBatch) -> CriticLoss:
    """The loss of all critics."""
    targets = _targets(state, data)
    contexts = {name: data.frames.now(trunk, data.states.get(name)) for name, trunk in state.online_trunks}
    loss: Tensor = torch.zeros((), device=data.rows.device)
    errors = torch.zeros(data.pieces, device=data.rows.device)
    metrics: dict[str, Tensor] = {}
    above: list[Tensor] = []
    for number, level in enumerate(state.levels):
        context, part = contexts[state.trunk_of(level.name)], data.levels[level.name]
        if level.plan.value_from == "below":
            below = state.levels[number + 1]
            target = _worth(state, below, contexts[state.trunk_of(below.name)], [*above, part.taken])
        else:
            target = targets[level.name]
        seen = joined(above, context)
        outputs = [level.rule.value_of(critic, context, seen, part.taken) for critic in level.online.critics]
        losses = torch.stack([state.values.loss(output, target) for output in outputs])
        level_loss = losses.sum(dim=0) @ part.weights
        loss = loss + level_loss
        value = state.values.mean(outputs[0].detach())
        error = (value - state.values.target_mean(target)).abs()
        errors.scatter_reduce_(0, data.rows, error, "amax")
        metrics[f"{level.name}/critic_loss"] = level_loss.detach()
        metrics[f"{level.name}/value"] = value @ part.weights
        metrics[f"{level.name}/td_error"] = error @ part.weights
        above.append(part.taken)
    detached = {name: context.detach().float() for name, context in contexts.items()}
    return CriticLoss(loss, detached, errors, metrics)


def actor_losses(
    state: TrainingState, data: TrainingBatch, contexts: Contexts
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """The loss of each level's actor, of which that actor alone is to learn; and metrics; float32 [] each.

    `contexts` have no gradient.
    """
    losses: dict[str, Tensor] = {}
    metrics: dict[str, Tensor] = {}
    above: list[Tensor] = []
    for number, level in enumerate(state.levels):
        part, context = data.levels[level.name], contexts[state.trunk_of(level.name)]
        if level.online.actor is not None:
            objective = level.rule.objective(level.online, context, joined(above, context))
            gain = objective.gain
            if level.plan.gradient_from_below:
                below = state.levels[number + 1]
                below_context = contexts[state.trunk_of(below.name)]
                seen = joined([*above, objective.action], context)
                joint = below.rule.objective(below.online, below_context, seen, penalised=False).gain
                gain = gain + level.plan.gradient_from_below * joint
            losses[level.name] = -(gain @ part.weights)
            metrics[f"{level.name}/actor_loss"] = losses[level.name].detach()
            saturated = (objective.raw.detach().abs() > 2).float().mean(dim=1)
            metrics[f"{level.name}/saturated"] = saturated @ part.weights
        above.append(part.taken)
    return losses, metrics


@torch.no_grad()
def _worth(state: TrainingState, level: Level, context: Tensor, above: list[Tensor]) -> Tensor:
    """What a level's critics say of its own decision here and now: as a target for those above it."""
    seen = joined(above, context)
    step = level.rule.following(level.online, level.online, (context, context), seen)
    reward = torch.zeros(len(context), device=context.device) if step.bonus is None else step.bonus
    return state.values.target(reward, torch.ones_like(reward), step.output())


@torch.no_grad()
def _targets(state: TrainingState, data: TrainingBatch) -> dict[str, Tensor]:
    """What critics are to say of decisions, by level; one that learns from below is not among them."""
    target = {
        name: data.frames.following(trunk, data.states.get(name)) for name, trunk in state.target_trunks
    }
    online = target
    if any(level.rule.needs_online_following for level in state.levels):
        online = {
            name: data.frames.following(trunk, data.states.get(name)) for name, trunk in state.online_trunks
        }
    followers = {
        horizon: _Following(state, data, horizon, target, online)
        for horizon in {part.horizon for part in data.levels.values()}
    }
    learning = [level for level in state.levels if level.plan.value_from == "experience"]
    return {level.name: followers[data.levels[level.name].horizon].target(level) for level in learning}


class _Following:
    """What the target networks say at one horizon, level by level."""

    def __init__(
        self, state: TrainingState, data: TrainingBatch, horizon: int, target: Contexts, online: Contexts
    ) -> None:
        self._state, self._data, self._horizon = state, data, horizon
        self._target, self._online = target, online
        self._outputs: dict[str, tuple[Tensor, Tensor | None]] = {}
        above: list[Tensor] = []
        for level in state.levels:
            above.append(self._decide(level, above))

    def _decide(self, level: Level, above: list[Tensor]) -> Tensor:
        """Look up what a level decides, or holds, and what that is worth: the decision [n, encoded]."""
        name, part = self._state.trunk_of(level.name), self._data.levels[level.name]
        contexts = (self._target[name][self._horizon], self._online[name][self._horizon])
        seen = joined(above, contexts[0])
        step = level.rule.following(level.target, level.online, contexts, seen)
        action, held = step.action, None
        if part.held is not None and part.in_force is not None:
            held, in_force = part.held[self._horizon].unsqueeze(1), part.in_force[self._horizon]
            action = torch.where(held, in_force, action)
        if level.plan.value_from == "experience":
            output = step.output()
            if held is not None:
                output_in_force = level.rule.target_output(level.target, contexts[0], seen, action)
                output = torch.where(held, output_in_force, output)
            self._outputs[level.name] = (output, step.bonus)
        return action

    def target(self, level: Level) -> Tensor:
        """What the level's critics are to say."""
        part = self._data.levels[level.name]
        output, bonus = self._outputs[level.name]
        reward = part.reward if bonus is None else part.reward + part.discount * bonus
        return self._state.values.target(reward, part.discount, output)


def joined(above: list[Tensor], context: Tensor) -> Tensor:
    """What the levels above have decided, side by side: [n, above], perhaps of no columns."""
    if not above:
        return context.new_zeros((len(context), 0))
    return above[0] if len(above) == 1 else torch.cat(above, dim=1)
