"""Prepares batches for updates: tensors on the learner's device, and the training data of each level.

The outcome of a decision is observed after a level's horizon, which is `n_step`, or the number of steps for
which the level holds its decision. Rewards until then are summed here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from athrl_planners.replay import Batch, Decisions, SequenceBatch, TransitionBatch
from athrl_planners.settings import PlannerSettings
from athrl_planners.training.frames import BurnIn, PaddedFrames, SequenceFrames, TransitionFrames
from athrl_planners.training.level import Level
from athrl_planners.training.mirror import mirrored


@dataclass(frozen=True)
class LevelData:
    """Training data of a level; n decisions.

    Attributes:
        taken: float32 [n, encoded], what it decided.
        reward: float32 [n], scaled, summed and discounted up to its horizon.
        discount: float32 [n], of the value at the horizon; 0 if the episode terminated.
        weights: float32 [n], of the decisions in its losses, with a sum of 1; 0 for padding, the burn-in, and
            where its decision is held.
        horizon: index of its own horizon.
        held: bool [horizons, n], whether its decision is still held there; None if it decides every time.
        in_force: float32 [horizons, n, encoded], the held decision.
    """

    taken: Tensor
    reward: Tensor
    discount: Tensor
    weights: Tensor
    horizon: int
    held: Tensor | None
    in_force: Tensor | None

    def part(self, place: slice) -> LevelData:
        """Some of the decisions, with their weights as they are."""
        return LevelData(
            self.taken[place],
            self.reward[place],
            self.discount[place],
            self.weights[place],
            self.horizon,
            None if self.held is None else self.held[:, place],
            None if self.in_force is None else self.in_force[:, place],
        )


@dataclass(frozen=True)
class TrainingBatch:
    """The input of an update.

    Attributes:
        frames: the observations.
        states: of each level float32 [batch, state], stored state of its trunk at the start of sequences.
        levels: training data of each level.
        item_of: int64 [n], index of the item to which each decision belongs.
        items: sequences or transitions in the batch.
    """

    frames: TransitionFrames | SequenceFrames | PaddedFrames
    states: dict[str, Tensor]
    levels: dict[str, LevelData]
    item_of: Tensor
    items: int

    def split(self, parts: int) -> list[TrainingBatch]:
        """Split into `parts` of about equal size, or as many as there are items, whose losses add up.

        Sequences are not split.
        """
        parts = min(parts, self.items)
        if parts == 1 or not isinstance(self.frames, TransitionFrames):
            return [self]
        slices = [slice(each[0], each[-1] + 1) for each in np.array_split(np.arange(self.items), parts)]
        return [self._part(place) for place in slices]

    def _part(self, place: slice) -> TrainingBatch:
        assert isinstance(self.frames, TransitionFrames)
        levels = {name: level.part(place) for name, level in self.levels.items()}
        items = place.stop - place.start
        return TrainingBatch(self.frames.part(place), {}, levels, self.item_of[:items], items)


class BatchPreparation:
    """Converts batches of the replay to tensors."""

    def __init__(
        self,
        settings: PlannerSettings,
        levels: tuple[Level, ...],
        burn_in: int,
        trunk_state: Mapping[str, int],
        device: torch.device,
        random: np.random.Generator,
        *,
        constant_shapes: bool,
    ) -> None:
        """Say how batches are prepared.

        `trunk_state` is the size of the trunk's part of each level's state, `random` is for mirroring; with
        `constant_shapes` sequences keep their padding, as recorded updates need them.
        """
        self._settings, self._levels, self._burn_in = settings, levels, burn_in
        self._trunk_state, self._device, self._random = dict(trunk_state), device, random
        self._constant_shapes = constant_shapes
        self.horizons = tuple(sorted({_horizon(level, settings) for level in levels}))

    def __call__(self, batch: Batch) -> TrainingBatch:
        """Prepare a batch."""
        if isinstance(batch, TransitionBatch):
            return self._transitions(
                mirrored(batch, self._levels, self._random) if self._settings.mirror else batch
            )
        return self._sequences(batch)

    def _transitions(self, batch: TransitionBatch) -> TrainingBatch:
        every = np.arange(len(batch.step))
        frames = TransitionFrames(self._tensor(batch.images), self._tensor(batch.motion))
        levels = {level.name: self._level_data(level, batch) for level in self._levels}
        return TrainingBatch(frames, {}, levels, self._tensor(every), len(every))

    def _sequences(self, batch: SequenceBatch) -> TrainingBatch:
        count, time = next(iter(batch.rewards.values())).shape
        steps, burn_in = np.arange(time)[:, None], self._burn_in_of(batch)
        trained = ((steps >= burn_in) & (steps < batch.length)).ravel()
        chosen = np.arange(time * count) if self._constant_shapes else np.flatnonzero(trained)
        step, index = np.divmod(chosen, count)
        decisions = self._decisions(batch, index, step, trained[chosen])
        levels = {level.name: self._level_data(level, decisions) for level in self._levels}
        states = {
            name: self._tensor(batch.initial_state[name][:, :size])
            for name, size in self._trunk_state.items()
            if size
        }
        item_of = self._tensor(index)
        if self._constant_shapes:
            frames = PaddedFrames(
                self._tensor(batch.images.swapaxes(0, 1)),
                self._tensor(batch.motion.swapaxes(0, 1)),
                self._tensor((steps < burn_in).reshape(-1, 1)),
                self._tensor(chosen + count * decisions.steps),
                self._whole(burn_in),
            )
            return TrainingBatch(frames, states, levels, item_of, count)
        return TrainingBatch(
            self._without_padding(batch, burn_in, chosen, decisions.steps), states, levels, item_of, count
        )

    def _without_padding(
        self, batch: SequenceBatch, burn_in: np.ndarray, trained: np.ndarray, ahead: np.ndarray
    ) -> SequenceFrames:
        count, frames = batch.motion.shape[:2]
        steps = np.arange(frames)[:, None]
        return SequenceFrames(
            self._tensor(_time_major(batch.images)),
            self._tensor(_time_major(batch.motion)),
            (frames - 1, count),
            (
                self._tensor(np.flatnonzero(steps[:-1] < burn_in)),
                self._tensor(trained),
                self._tensor(np.flatnonzero(steps <= batch.length)),
            ),
            self._tensor(ahead),
            self._whole(burn_in),
        )

    def _whole(self, burn_in: np.ndarray) -> BurnIn:
        return BurnIn(self._burn_in, self._tensor((burn_in == self._burn_in)[:, None]))

    def _decisions(
        self, batch: SequenceBatch, index: np.ndarray, step: np.ndarray, trained: np.ndarray
    ) -> Decisions:
        """The decisions at these steps of these sequences; of those that are not trained, without weight."""
        length, names = batch.length[index], [level.name for level in self._levels]
        time = next(iter(batch.rewards.values())).shape[1]
        # At least one step, for padding: the frame there exists, and its value has no weight.
        ahead = np.maximum(1, np.minimum(np.array(self.horizons)[:, None], length - step))
        window = step[:, None] + np.arange(max(self.horizons))
        inside = window < length[:, None]
        window = np.minimum(window, time - 1)
        return Decisions(
            actions={name: batch.actions[name][index, step] for name in names},
            last_actions={name: batch.actions[name][index, step + ahead - 1] for name in names},
            rewards={
                name: np.where(inside, batch.rewards[name][index[:, None], window], np.float32(0))
                for name in names
            },
            steps=ahead,
            terminated=batch.terminated[index] & (step + ahead == length),
            initial_state={name: batch.initial_state[name][index] for name in names},
            step=step,
            weights=batch.weights[index] * trained,
        )

    def _level_data(self, level: Level, decisions: Decisions) -> LevelData:
        """Make the training data of a level."""
        settings, every = self._settings, level.plan.every
        rewards, steps, step = decisions.rewards[level.name], decisions.steps, decisions.step
        weights = decisions.weights
        horizon = self.horizons.index(_horizon(level, settings))
        ahead, ended = steps[horizon], decisions.terminated[horizon]
        powers = settings.discount ** np.arange(rewards.shape[1])
        counted = np.arange(rewards.shape[1]) < ahead[:, None]
        reward = settings.reward_scale * ((rewards * counted) @ powers)
        reward -= ended * settings.end_penalty * settings.discount ** (ahead - 1)
        held = in_force = None
        if every > 1:
            # decisions for which it is still held at the start
            left = decisions.initial_state[level.name][:, -1].round().astype(np.int64)
            weights = weights * ((left - step) % every == 0)
            held = self._tensor((left - step - steps) % every != 0)
            last = decisions.last_actions[level.name]
            in_force = torch.stack([level.rule.encode(self._tensor(each)) for each in last])
        total = weights.sum()
        return LevelData(
            taken=level.rule.encode(self._tensor(decisions.actions[level.name])),
            reward=self._tensor(reward.astype(np.float32)),
            discount=self._tensor(np.where(ended, 0.0, settings.discount**ahead).astype(np.float32)),
            weights=self._tensor((weights / (total if total > 0 else 1.0)).astype(np.float32)),
            horizon=horizon,
            held=held,
            in_force=in_force,
        )

    def _burn_in_of(self, batch: SequenceBatch) -> np.ndarray:
        """Length of the burn-in of each sequence: int64 [batch].

        0 at the start of an episode: the zeros stored there are exact. And always less than the length of the
        sequence, so that the last decision of an episode, which may be a collision, is trained even if its
        sequence is short.
        """
        stored = np.concatenate(list(batch.initial_state.values()), axis=1)
        return np.where(~stored.any(axis=1), 0, np.minimum(self._burn_in, batch.length - 1))

    def _tensor(self, values: np.ndarray) -> Tensor:
        tensor = torch.from_numpy(np.ascontiguousarray(values))
        if self._device.type == "cuda":  # only copies from pinned memory are asynchronous
            tensor = tensor.pin_memory()
        return tensor.to(self._device, non_blocking=True)


def _horizon(level: Level, settings: PlannerSettings) -> int:
    return level.plan.every if level.plan.every > 1 else settings.n_step


def _time_major(column: np.ndarray) -> np.ndarray:
    swapped = column.swapaxes(0, 1)
    return swapped.reshape(-1, *swapped.shape[2:])
