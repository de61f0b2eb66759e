"""The observations of a batch, encoded for the decisions that are trained and for their outcomes.

Single decisions have two or more observations each. Whole sequences are unrolled through a memory, and they
come in two arrangements with equal results: without their padding, which is less work, and with it, so that
every batch has the same shapes and an update can be recorded on a GPU.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from athrl_planners.networks import Trunk, as_pixels


class BurnIn(NamedTuple):
    """The burn-in of a batch: first steps of sequences that only update the memory's state (R2D2).

    No gradient passes through it. Only where a sequence is shorter, its last decision trains through it.
    """

    steps: int
    whole: Tensor
    """bool [batch, 1], which sequences have all of it; those at the start of an episode have none."""


class TransitionFrames:
    """Observations of single decisions and of their outcomes, for planners without memory."""

    def __init__(self, images: Tensor, motion: Tensor) -> None:
        """`images` uint8 [1 + horizons, n, h, w, channels], `motion` float32 [1 + horizons, n, m]."""
        self.images, self.motion = images, motion

    def current(self, trunk: Trunk, state: Tensor | None) -> Tensor:
        """Contexts of the decisions: [n, context]; `state` is that at the start of sequences."""
        return trunk.features(as_pixels(self.images[0]), self.motion[0])

    def next(self, trunk: Trunk, state: Tensor | None) -> Tensor:
        """Contexts at the horizons: [horizons, n, context]."""
        pixels, motion = as_pixels(self.images[1:].flatten(0, 1)), self.motion[1:].flatten(0, 1)
        return trunk.features(pixels, motion).unflatten(0, (len(self.images) - 1, -1))

    def tensors(self) -> tuple[Tensor, ...]:
        """All tensors, in a fixed order."""
        return (self.images, self.motion)

    def of(self, tensors: Iterator[Tensor]) -> TransitionFrames:
        """Frames like these of other tensors, in the order of `tensors`."""
        return TransitionFrames(next(tensors), next(tensors))

    def part(self, place: slice) -> TransitionFrames:
        """Those of some of the decisions."""
        return TransitionFrames(self.images[:, place], self.motion[:, place])


class SequenceFrames:
    """Observations of whole sequences; padding is skipped, and the burn-in does not train the encoder.

    Frames are numbered `step * batch + sequence`.

    Attributes:
        trained: int64 [n], frames of the decisions that are trained.
    """

    def __init__(
        self,
        images: Tensor,
        motion: Tensor,
        size: tuple[int, int],
        places: tuple[Tensor, ...],
        steps: Tensor,
        burn_in: BurnIn,
    ) -> None:
        """Take frames in time-major order.

        Args:
            images: uint8 [(time + 1) * batch, height, width, channels].
            motion: float32 [(time + 1) * batch, m].
            size: time and batch.
            places: int64 frames: of the burn-in, of the trained decisions, of everything but padding.
            steps: int64 [horizons, n], from each decision to its horizons.
            burn_in: of the sequences.
        """
        self._images, self._motion, self._burn_in = images, motion, burn_in
        self._time, self._batch = size
        self._burn_in_frames, self.trained, self._observed = places
        self._after = self.trained + self._batch * steps

    def current(self, trunk: Trunk, state: Tensor | None) -> Tensor:
        """Contexts of the decisions: [n, context]; `state` is that at the start of sequences."""
        with torch.no_grad():
            burn_in_features = self._features(trunk, self._burn_in_frames)
        trained = self._features(trunk, self.trained)
        features = trained.new_zeros(self._time * self._batch, trained.shape[1])
        features = features.index_copy(0, self._burn_in_frames, burn_in_features).index_copy(
            0, self.trained, trained
        )
        return _unroll(trunk, features, self._burn_in, state)[self.trained]

    def next(self, trunk: Trunk, state: Tensor | None) -> Tensor:
        """Contexts at the horizons: [horizons, n, context]."""
        observed = self._features(trunk, self._observed)
        features = observed.new_zeros((self._time + 1) * self._batch, observed.shape[1])
        features = features.index_copy(0, self._observed, observed)
        return _unroll(trunk, features, self._burn_in, state)[self._after]

    def _features(self, trunk: Trunk, places: Tensor) -> Tensor:
        return trunk.features(as_pixels(self._images[places]), self._motion[places]).float()


class PaddedFrames:
    """Observations of whole sequences with their padding, for which the losses have no weight.

    All time * batch steps count as decisions, in the order of `SequenceFrames`: the shapes do not depend on
    how long the sequences are. The burn-in does not train the encoder.
    """

    def __init__(
        self, images: Tensor, motion: Tensor, spared: Tensor, after: Tensor, burn_in: BurnIn
    ) -> None:
        """Take frames.

        Args:
            images: uint8 [time + 1, batch, height, width, channels].
            motion: float32 [time + 1, batch, m].
            spared: bool [time * batch, 1], which decisions belong to the burn-in.
            after: int64 [horizons, time * batch], frames at the horizons of each decision.
            burn_in: of the sequences.
        """
        self._images, self._motion, self._spared, self._after = images, motion, spared, after
        self._burn_in = burn_in

    def current(self, trunk: Trunk, state: Tensor | None) -> Tensor:
        """Contexts of the decisions: [n, context]; `state` is that at the start of sequences."""
        features = self._features(trunk, self._images[:-1], self._motion[:-1])
        features = torch.where(self._spared, features.detach(), features)
        return _unroll(trunk, features, self._burn_in, state)

    def next(self, trunk: Trunk, state: Tensor | None) -> Tensor:
        """Contexts at the horizons: [horizons, n, context]."""
        features = self._features(trunk, self._images, self._motion)
        return _unroll(trunk, features, self._burn_in, state)[self._after]

    def tensors(self) -> tuple[Tensor, ...]:
        """All tensors, in a fixed order."""
        return (self._images, self._motion, self._spared, self._after, self._burn_in.whole)

    def of(self, tensors: Iterator[Tensor]) -> PaddedFrames:
        """Frames like these of other tensors, in the order of `tensors`."""
        images, motion, spared, after, whole = (next(tensors) for _ in range(5))
        return PaddedFrames(images, motion, spared, after, self._burn_in._replace(whole=whole))

    @staticmethod
    def _features(trunk: Trunk, images: Tensor, motion: Tensor) -> Tensor:
        return trunk.features(as_pixels(images.flatten(0, 1)), motion.flatten(0, 1)).float()


def _unroll(trunk: Trunk, features: Tensor, burn_in: BurnIn, state: Tensor | None) -> Tensor:
    """Features [steps * batch, f] -> contexts [steps * batch, context]."""
    assert state is not None
    by_step = features.unflatten(0, (-1, len(burn_in.whole)))
    with torch.autocast(features.device.type, enabled=False):
        if burn_in.steps == 0:
            return trunk.unroll(by_step, state)[0].flatten(0, 1)
        first, reached = trunk.unroll(by_step[: burn_in.steps], state)
        reached = torch.where(burn_in.whole, reached.detach(), reached)
        rest, _ = trunk.unroll(by_step[burn_in.steps :], reached)
    return torch.cat((first, rest)).flatten(0, 1)
