"""Exchange left and right in half of the transitions of a batch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from athrl_spaces import Action, Continuous

from athrl_planners.replay import TransitionBatch
from athrl_planners.training.level import Level

SIDEWAYS_MOTION = (1,)
"""Indices of the motion vector that change their sign: the steering."""


def mirrored(
    batch: TransitionBatch, levels: tuple[Level, ...], random: np.random.Generator
) -> TransitionBatch:
    """The batch with left and right exchanged in about half of it; the given batch may be changed."""
    chosen = random.random(len(batch.step)) < 0.5
    batch.images[:, chosen] = batch.images[:, chosen, :, ::-1]
    for entry in SIDEWAYS_MOTION:
        batch.motion[:, chosen, entry] *= -1
    actions, last_actions = dict(batch.actions), dict(batch.last_actions)
    for level in levels:
        for column, action in enumerate(level.plan.actions):
            for columns in (actions[level.name], last_actions[level.name]):
                columns[..., chosen, column] = _other_side(action, columns[..., chosen, column])
    return replace(batch, actions=actions, last_actions=last_actions)


def _other_side(action: Action, values: np.ndarray) -> np.ndarray:
    if isinstance(action, Continuous):
        return 2 * action.centre - values if action.sideways else values
    return np.array(action.mirrored, values.dtype)[values.astype(np.int64)] if action.mirrored else values
