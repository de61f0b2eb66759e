"""Losses of an update: the critics' loss and the actors' losses of a planner's levels.

For levels from the highest down, with s the context of a level's trunk, `above` the decisions of the levels
above, and Q', pi' the target networks:

    target     y = r + discount^n * Q'(s', above', pi'(s', above'))        n steps later
    critics    minimise the loss of Q(s, above, a) against y; the trunk only learns from this
    actors     maximise Q(s, above, pi(s, above)), and, for a level with `gradient_from_below`, the next
               level's Q(s, pi(s), pi_below(s, pi(s))) as well (paper, "Hierarchical Off-Policy Actor-Critic")
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from athrl_planners.training.batch import TrainingBatch
from athrl_planners.training.level import Level
from athrl_planners.training.state import TrainingState

Contexts = Mapping[str, Tensor]
"""By name of the trunk: [n, context], or [horizons, n, context]."""


class CriticLoss(NamedTuple):
    """The critics' loss, and the results for actors and replay."""

    loss: Tensor
    """float32 []"""
    contexts: dict[str, Tensor]
    """By name of the trunk float32 [n, context], without gradient."""
    errors: Tensor
    """float32 [items], the largest absolute error of each item of the batch, of what its levels train on."""
    metrics: dict[str, Tensor]
    """float32 [] each."""


def critic_loss(state: TrainingState, data: TrainingBatch) -> CriticLoss:
    """The loss of all critics."""
    targets = _targets(state, data)
    contexts = {
        name: data.frames.current(trunk, data.states.get(name)) for name, trunk in state.online_trunks
    }
    loss: Tensor = torch.zeros((), device=data.item_of.device)
    errors = torch.zeros(data.items, device=data.item_of.device)
    metrics: dict[str, Tensor] = {}
    above: list[Tensor] = []
    for number, level in enumerate(state.levels):
        context, part = contexts[state.trunk_of(level.name)], data.levels[level.name]
        if level.plan.value_from == "below":
            below = state.levels[number + 1]
            target = _target_from_below(
                state, below, contexts[state.trunk_of(below.name)], [*above, part.taken]
            )
        else:
            target = targets[level.name]
        seen = joined(above, context)
        outputs = [level.rule.value_of(critic, context, seen, part.taken) for critic in level.online.critics]
        losses = torch.stack([state.values.loss(output, target) for output in outputs])
        level_loss = weighted_sum(losses.sum(dim=0), part.weights)
        loss = loss + level_loss
        value = state.values.mean(outputs[0].detach())
        error = (value - state.values.target_mean(target)).abs()
        errors.scatter_reduce_(0, data.item_of, error * (part.weights > 0), "amax")
        metrics[f"{level.name}/critic_loss"] = level_loss.detach()
        metrics[f"{level.name}/value"] = weighted_sum(value, part.weights)
        metrics[f"{level.name}/td_error"] = weighted_sum(error, part.weights)
        above.append(part.taken)
    detached = {name: context.detach().float() for name, context in contexts.items()}
    return CriticLoss(loss, detached, errors, metrics)


def actor_losses(
    state: TrainingState, data: TrainingBatch, contexts: Contexts
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """The loss of each level's actor, from which only that actor learns; and metrics; float32 [] each.

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
            losses[level.name] = -weighted_sum(gain, part.weights)
            metrics[f"{level.name}/actor_loss"] = losses[level.name].detach()
            saturated = (objective.raw.detach().abs() > 2).float().mean(dim=1)
            metrics[f"{level.name}/saturated"] = weighted_sum(saturated, part.weights)
        above.append(part.taken)
    return losses, metrics


def weighted_sum(values: Tensor, weights: Tensor) -> Tensor:
    """The sum of values [n] by their weights [n]: float32 [], which autocast would round to bfloat16."""
    with torch.autocast(values.device.type, enabled=False):
        return values.float() @ weights


@torch.no_grad()
def _target_from_below(state: TrainingState, level: Level, context: Tensor, above: list[Tensor]) -> Tensor:
    """The value of a level's own decision by its own critics, as a target for the level above."""
    seen = joined(above, context)
    step = level.rule.next_step(level.online, level.online, (context, context), seen)
    reward = torch.zeros(len(context), device=context.device) if step.bonus is None else step.bonus
    return state.values.target(reward, torch.ones_like(reward), step.output())


@torch.no_grad()
def _targets(state: TrainingState, data: TrainingBatch) -> dict[str, Tensor]:
    """Targets of the critics by level; without levels that learn from below."""
    target = {name: data.frames.next(trunk, data.states.get(name)) for name, trunk in state.target_trunks}
    online = target
    if any(level.rule.needs_online_next for level in state.levels):
        online = {name: data.frames.next(trunk, data.states.get(name)) for name, trunk in state.online_trunks}
    next_decisions = {
        horizon: _NextDecisions(state, data, horizon, target, online)
        for horizon in {part.horizon for part in data.levels.values()}
    }
    learning = [level for level in state.levels if level.plan.value_from == "experience"]
    return {level.name: next_decisions[data.levels[level.name].horizon].target(level) for level in learning}


class _NextDecisions:
    """Next decisions and values of the target networks at one horizon, level by level."""

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
        """Compute a level's new or held decision, and its value; return the decision [n, encoded]."""
        name, part = self._state.trunk_of(level.name), self._data.levels[level.name]
        contexts = (self._target[name][self._horizon], self._online[name][self._horizon])
        seen = joined(above, contexts[0])
        step = level.rule.next_step(level.target, level.online, contexts, seen)
        action, bonus, held = step.action, step.bonus, None
        if part.held is not None and part.in_force is not None:
            held, in_force = part.held[self._horizon].unsqueeze(1), part.in_force[self._horizon]
            action = torch.where(held, in_force, action)
        if level.plan.value_from == "experience":
            output = step.output()
            if held is not None:
                output_in_force = level.rule.target_output(level.target, contexts[0], seen, action)
                output = torch.where(held, output_in_force, output)
                bonus = None if bonus is None else bonus.masked_fill(held.squeeze(1), 0.0)
            self._outputs[level.name] = (output, bonus)
        return action

    def target(self, level: Level) -> Tensor:
        """The target of the level's critics."""
        part = self._data.levels[level.name]
        output, bonus = self._outputs[level.name]
        reward = part.reward if bonus is None else part.reward + part.discount * bonus
        return self._state.values.target(reward, part.discount, output)


def joined(above: list[Tensor], context: Tensor) -> Tensor:
    """Decisions of the levels above, concatenated: [n, above]; may have no columns."""
    if not above:
        return context.new_zeros((len(context), 0))
    return above[0] if len(above) == 1 else torch.cat(above, dim=1)
