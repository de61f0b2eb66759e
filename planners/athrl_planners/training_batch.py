"""A batch of sequences as an update needs it: tensors in time-major order, and which decisions are for what.

Three kinds of decisions: trained ones enter the losses; warming ones (the burn-in) only bring the recurrent
state up to date with the present networks; padding is never looked at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from athrl_planners.networks import as_pixels
from athrl_planners.sequence import SequenceBatch


@dataclass(frozen=True)
class TrainingBatch:
    """Frames are numbered `step * batch + row`; n is the number of trained decisions."""

    time: int  # decisions of a sequence, padding included
    batch: int
    pixels: Tensor  # float32 [(time + 1) * batch, channels, height, width] in 0..1
    motion: Tensor  # float32 [(time + 1) * batch, motion]
    initial_state: dict[str, Tensor]  # per level: float32 [batch, state]
    warming: Tensor  # int64 [warming]: frames of the burn-in
    trained: Tensor  # int64 [n]: frames of the decisions that are trained
    observed: Tensor  # int64 [observed]: all frames but padding, the ones after the last decisions included
    actions: dict[str, Tensor]  # per level: float32 [n, actions], physical units
    rewards: dict[str, Tensor]  # per level: float32 [n]
    continues: Tensor  # float32 [n]: 0 where the episode truly ended with the decision
    weights: Tensor  # float32 [n], with a sum of 1


def prepare(
    batch: SequenceBatch, burn_in: int, weights: np.ndarray | None, device: torch.device
) -> TrainingBatch:
    """Sort out a batch; `weights` float32 [batch] weigh its sequences (none: equally)."""
    rows, time = next(iter(batch.rewards.values())).shape
    steps = np.arange(time)[:, None]
    last = batch.length - 1
    warm = _burn_in(batch, burn_in)
    trained = np.flatnonzero((steps >= warm) & (steps <= last))
    warming = np.flatnonzero(steps < warm)
    observed = np.flatnonzero(np.arange(time + 1)[:, None] <= batch.length)
    ends = (steps == last) & batch.terminated
    shares = np.broadcast_to(np.ones(rows) if weights is None else weights, (time, rows)).reshape(-1)[trained]

    def tensor(values: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(device)

    def flat(column: np.ndarray) -> np.ndarray:
        swapped = column.swapaxes(0, 1)
        return swapped.reshape(-1, *swapped.shape[2:])

    return TrainingBatch(
        time=time,
        batch=rows,
        pixels=as_pixels(tensor(flat(batch.images))),
        motion=tensor(flat(batch.motion)),
        initial_state={level: tensor(state) for level, state in batch.initial_state.items()},
        warming=tensor(warming),
        trained=tensor(trained),
        observed=tensor(observed),
        actions={level: tensor(flat(column)[trained]) for level, column in batch.actions.items()},
        rewards={level: tensor(flat(column)[trained]) for level, column in batch.rewards.items()},
        continues=tensor(1 - ends.reshape(-1)[trained].astype(np.float32)),
        weights=tensor((shares / shares.sum()).astype(np.float32)),
    )


def _burn_in(batch: SequenceBatch, burn_in: int) -> np.ndarray:
    """How many decisions of each sequence only warm the recurrent state: int64 [batch].

    None where an episode starts: the zeros stored there are exact. And always fewer than the sequence has, so
    that an episode's last decision, which may be a collision, is trained even when it lies in a short rest.
    """
    stored = np.concatenate(list(batch.initial_state.values()), axis=1)
    starts = ~stored.any(axis=1)
    return np.where(starts, 0, np.minimum(burn_in, batch.length - 1))
