"""A batch as an update needs it: tensors on the learner's device, and what each level is to learn from.

Some steps after a decision its future is looked at again: after a level's horizon, which is `n_step`, or as
many steps as the level holds its decision for. What happened until then is summed up here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from athrl_planners.level import Level
from athrl_planners.mirror import mirrored
from athrl_planners.networks import Trunk, as_pixels
from athrl_planners.replay import Batch, SequenceBatch, TransitionBatch
from athrl_planners.settings import PlannerSettings

Arrays = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class LevelData:
    """What a level learns from; n decisions.

    Attributes:
        taken: float32 [n, encoded], what it decided.
        reward: float32 [n], scaled, summed and discounted up to its horizon.
        discount: float32 [n], of the value there; 0 where the episode truly ended.
        weights: float32 [n], of the decisions in its losses, with a sum of 1.
        horizon: which of the horizons is its own.
        held: bool [horizons, n], whether its decision is still in force there; none: it decides every time.
        in_force: float32 [horizons, n, encoded], that decision.
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


class TransitionFrames:
    """Observations of single decisions, and of what followed; there is nothing to remember."""

    def __init__(self, images: Tensor, motion: Tensor) -> None:
        """`images` uint8 [1 + horizons, n, h, w, channels], `motion` float32 [1 + horizons, n, m]."""
        self.images, self.motion = images, motion

    def now(self, trunk: Trunk, state: Tensor | None) -> Tensor:
        """Contexts of the decisions: [n, context]."""
        return trunk.features(as_pixels(self.images[0]), self.motion[0])

    def following(self, trunk: Trunk, state: Tensor | None) -> Tensor:
        """Contexts of what followed: [horizons, n, context]."""
        pixels, motion = as_pixels(self.images[1:].flatten(0, 1)), self.motion[1:].flatten(0, 1)
        return trunk.features(pixels, motion).unflatten(0, (len(self.images) - 1, -1))


class SequenceFrames:
    """Observations of whole sequences; padding is not looked at, and the burn-in has no gradient.

    Frames are numbered `step * batch + row`.

    Attributes:
        trained: int64 [n], frames of the decisions that are trained.
    """

    def __init__(
        self, images: Tensor, motion: Tensor, size: tuple[int, int], places: tuple[Tensor, ...], steps: Tensor
    ) -> None:
        """Take frames in time-major order.

        Args:
            images: uint8 [(time + 1) * batch, height, width, channels].
            motion: float32 [(time + 1) * batch, m].
            size: time and batch.
            places: int64 frames: of the burn-in, of the trained decisions, of everything but padding.
            steps: int64 [horizons, n], from each decision to its horizons.
        """
        self._images, self._motion = images, motion
        self._time, self._batch = size
        self._burned_in, self.trained, self._observed = places
        self._after = self.trained + self._batch * steps

    def now(self, trunk: Trunk, state: Tensor | None) -> Tensor:
        """Contexts of the trained decisions: [n, context]."""
        with torch.no_grad():
            burned_in = self._features(trunk, self._burned_in)
        trained = self._features(trunk, self.trained)
        features = trained.new_zeros(self._time * self._batch, trained.shape[1])
        features = features.index_copy(0, self._burned_in, burned_in).index_copy(0, self.trained, trained)
        return self._unroll(trunk, features, state)[self.trained]

    def following(self, trunk: Trunk, state: Tensor | None) -> Tensor:
        """Contexts at the horizons: [horizons, n, context]."""
        observed = self._features(trunk, self._observed)
        features = observed.new_zeros((self._time + 1) * self._batch, observed.shape[1])
        features = features.index_copy(0, self._observed, observed)
        return self._unroll(trunk, features, state)[self._after]

    def _features(self, trunk: Trunk, places: Tensor) -> Tensor:
        return trunk.features(as_pixels(self._images[places]), self._motion[places]).float()

    def _unroll(self, trunk: Trunk, features: Tensor, state: Tensor | None) -> Tensor:
        assert state is not None
        with torch.autocast(features.device.type, enabled=False):
            contexts, _ = trunk.unroll(features.unflatten(0, (-1, self._batch)), state)
        return contexts.flatten(0, 1)


@dataclass(frozen=True)
class TrainingBatch:
    """What an update takes.

    Attributes:
        frames: the observations.
        states: of each level float32 [batch, state], its trunk's remembered state where sequences begin.
        levels: what each level learns from.
        rows: int64 [n], the piece of the batch that each decision belongs to.
        pieces: sequences or transitions in the batch.
    """

    frames: TransitionFrames | SequenceFrames
    states: dict[str, Tensor]
    levels: dict[str, LevelData]
    rows: Tensor
    pieces: int

    def split(self, parts: int) -> list[TrainingBatch]:
        """As many parts of about equal size, whose losses add up to the whole's; sequences stay together."""
        if parts == 1 or not isinstance(self.frames, TransitionFrames):
            return [self]
        places = [slice(each[0], each[-1] + 1) for each in np.array_split(np.arange(self.pieces), parts)]
        return [self._part(place) for place in places]

    def _part(self, place: slice) -> TrainingBatch:
        assert isinstance(self.frames, TransitionFrames)
        frames = TransitionFrames(self.frames.images[:, place], self.frames.motion[:, place])
        levels = {name: level.part(place) for name, level in self.levels.items()}
        pieces = place.stop - place.start
        return TrainingBatch(frames, {}, levels, self.rows[:pieces], pieces)


class BatchPreparation:
    """Turns what the replay samples into tensors."""

    def __init__(
        self,
        settings: PlannerSettings,
        levels: tuple[Level, ...],
        burn_in: int,
        trunk_state: Mapping[str, int],
        device: torch.device,
        random: np.random.Generator,
    ) -> None:
        """`trunk_state` says how much of each level's state is its trunk's; `random` mirrors."""
        self._settings, self._levels, self._burn_in = settings, levels, burn_in
        self._trunk_state, self._device, self._random = dict(trunk_state), device, random
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
        levels = {
            level.name: self._level_data(
                level,
                actions=batch.actions[level.name],
                last_actions=batch.last_actions[level.name],
                rewards=batch.rewards[level.name],
                steps=batch.steps,
                ends=batch.terminated,
                state=batch.initial_state[level.name],
                step=batch.step,
                weights=batch.weights,
            )
            for level in self._levels
        }
        return TrainingBatch(frames, {}, levels, self._tensor(every), len(every))

    def _sequences(self, batch: SequenceBatch) -> TrainingBatch:
        rows, time = next(iter(batch.rewards.values())).shape
        steps = np.arange(time)[:, None]
        burn_in = self._burn_in_of(batch)
        trained = np.flatnonzero((steps >= burn_in) & (steps < batch.length))
        step, row = np.divmod(trained, rows)
        ahead = np.minimum(np.array(self.horizons)[:, None], batch.length[row] - step)
        window = step[:, None] + np.arange(max(self.horizons))
        inside = window < batch.length[row][:, None]
        window = np.minimum(window, time - 1)
        frames = SequenceFrames(
            self._tensor(_time_major(batch.images)),
            self._tensor(_time_major(batch.motion)),
            (time, rows),
            (
                self._tensor(np.flatnonzero(steps < burn_in)),
                self._tensor(trained),
                self._tensor(np.flatnonzero(np.arange(time + 1)[:, None] <= batch.length)),
            ),
            self._tensor(ahead),
        )
        levels = {
            level.name: self._level_data(
                level,
                actions=batch.actions[level.name][row, step],
                last_actions=batch.actions[level.name][row, step + ahead - 1],
                rewards=np.where(inside, batch.rewards[level.name][row[:, None], window], np.float32(0)),
                steps=ahead,
                ends=batch.terminated[row] & (step + ahead == batch.length[row]),
                state=batch.initial_state[level.name][row],
                step=step,
                weights=batch.weights[row],
            )
            for level in self._levels
        }
        states = {
            name: self._tensor(batch.initial_state[name][:, :size])
            for name, size in self._trunk_state.items()
            if size
        }
        return TrainingBatch(frames, states, levels, self._tensor(row), rows)

    def _level_data(
        self,
        level: Level,
        *,
        actions: np.ndarray,
        last_actions: np.ndarray,
        rewards: np.ndarray,
        steps: np.ndarray,
        ends: np.ndarray,
        state: np.ndarray,
        step: np.ndarray,
        weights: np.ndarray,
    ) -> LevelData:
        """Sum up what a level learns from; shapes as in `TransitionBatch`."""
        settings, every = self._settings, level.plan.every
        horizon = self.horizons.index(_horizon(level, settings))
        ahead, ended = steps[horizon], ends[horizon]
        powers = settings.discount ** np.arange(rewards.shape[1])
        counted = np.arange(rewards.shape[1]) < ahead[:, None]
        reward = settings.reward_scale * ((rewards * counted) @ powers)
        reward -= ended * settings.end_penalty * settings.discount ** (ahead - 1)
        held = in_force = None
        if every > 1:
            left = state[:, -1].round().astype(np.int64)  # decisions for which it was held, at the beginning
            weights = weights * ((left - step) % every == 0)
            held = self._tensor((left - step - steps) % every != 0)
            in_force = torch.stack([level.rule.encode(self._tensor(each)) for each in last_actions])
        total = weights.sum()
        return LevelData(
            taken=level.rule.encode(self._tensor(actions)),
            reward=self._tensor(reward.astype(np.float32)),
            discount=self._tensor(np.where(ended, 0.0, settings.discount**ahead).astype(np.float32)),
            weights=self._tensor((weights / (total if total > 0 else 1.0)).astype(np.float32)),
            horizon=horizon,
            held=held,
            in_force=in_force,
        )

    def _burn_in_of(self, batch: SequenceBatch) -> np.ndarray:
        """How many decisions of each sequence only warm the recurrent state: int64 [batch].

        None where an episode starts: the zeros stored there are exact. And always fewer than the sequence
        has, so that an episode's last decision, which may be a collision, is trained even when it lies in a
        short rest.
        """
        stored = np.concatenate(list(batch.initial_state.values()), axis=1)
        return np.where(~stored.any(axis=1), 0, np.minimum(self._burn_in, batch.length - 1))

    def _tensor(self, values: np.ndarray) -> Tensor:
        tensor = torch.from_numpy(np.ascontiguousarray(values))
        if self._device.type == "cuda":  # only from pinned memory is a copy not waited for
            tensor = tensor.pin_memory()
        return tensor.to(self._device, non_blocking=True)


def _horizon(level: Level, settings: PlannerSettings) -> int:
    return level.plan.every if level.plan.every > 1 else settings.n_step


def _time_major(column: np.ndarray) -> np.ndarray:
    swapped = column.swapaxes(0, 1)
    return swapped.reshape(-1, *swapped.shape[2:])
