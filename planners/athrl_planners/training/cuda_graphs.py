"""Updates on a GPU as two CUDA graphs, one with and one without the actors' step.

An update consists of some hundred small kernels, and launching them one by one takes longer than running
them. So the update reads its batch and its step size from fixed buffers, is recorded once as a CUDA graph,
and is replayed from then on. If recording fails, or on a CPU, the same updates run without graphs.
"""

from __future__ import annotations

import logging
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import replace

import torch
from torch import Tensor

from athrl_planners.training.batch import LevelData, TrainingBatch
from athrl_planners.training.frames import PaddedFrames, TransitionFrames

log = logging.getLogger(__name__)

Compute = Callable[[TrainingBatch, Tensor, bool], tuple[dict[str, Tensor], Tensor]]
"""An update without its counter, for a batch and a step size float [], with or without the actors' step."""

WARM_UP = 3
"""Updates of each kind before it is recorded: libraries allocate memory in the first ones."""


class CapturedUpdate:
    """Runs updates from fixed buffers, recorded if there is a GPU.

    Args:
        compute: the update, which does not synchronise.
        parameters: parameters with gradients in the update.
        generator: generator of its noise.
        device: device of the update.
    """

    def __init__(
        self, compute: Compute, parameters: list[Tensor], generator: torch.Generator, device: torch.device
    ) -> None:
        self._compute, self._parameters, self._generator = compute, parameters, generator
        self._records = device.type == "cuda"
        self._stream = torch.cuda.Stream(device) if self._records else None
        # On a GPU Adam only accepts float32; on a CPU the dtype of a plain number.
        dtype = torch.float32 if self._records else torch.float64
        self._rate = torch.zeros((), dtype=dtype, device=device)
        self._batch: TrainingBatch | None = None
        self._buffers: list[Tensor] = []
        self._recordings: dict[bool, Recording] = {}
        self._runs = {False: 0, True: 0}

    @staticmethod
    def takes(data: TrainingBatch) -> bool:
        """Whether batches of this kind have constant shapes."""
        return isinstance(data.frames, TransitionFrames | PaddedFrames)

    def __call__(
        self, data: TrainingBatch, rate: float, with_actors: bool
    ) -> tuple[dict[str, Tensor], Tensor]:
        """Do one update; results as of `compute`, in new memory."""
        batch = self._take(data)
        self._rate.fill_(rate)
        if self._records and with_actors not in self._recordings and self._runs[with_actors] >= WARM_UP:
            self._record(batch, with_actors)
        if with_actors in self._recordings:
            return self._recordings[with_actors].play()
        self._runs[with_actors] += 1
        return self._run(batch, with_actors)

    def _take(self, data: TrainingBatch) -> TrainingBatch:
        """Copy the batch to the buffers; other shapes get new buffers and recordings."""
        tensors = list(_tensors(data))
        shapes = [(tensor.shape, tensor.dtype) for tensor in tensors]
        if self._batch is None or shapes != [(buffer.shape, buffer.dtype) for buffer in self._buffers]:
            self._recordings.clear()
            self._runs = {False: 0, True: 0}
            self._buffers = [tensor.clone() for tensor in tensors]
            self._batch = _of_tensors(data, iter(self._buffers))
        else:
            torch._foreach_copy_(self._buffers, tensors)
        return self._batch

    def _run(self, batch: TrainingBatch, with_actors: bool) -> tuple[dict[str, Tensor], Tensor]:
        if self._stream is None:
            return self._compute(batch, self._rate, with_actors)
        # On the stream that records later, as torch requires.
        self._stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(self._stream):
            results = self._compute(batch, self._rate, with_actors)
        torch.cuda.current_stream().wait_stream(self._stream)
        return results

    def _record(self, batch: TrainingBatch, with_actors: bool) -> None:
        """Record an update, without running it; after a failure there is a warning and no further attempt."""
        try:
            self._recordings[with_actors] = record(
                lambda: self._compute(batch, self._rate, with_actors), self._generator, self._stream
            )
        except RuntimeError as error:
            self._records = False
            self._recordings.clear()
            for parameter in self._parameters:
                parameter.grad = None
            reason = textwrap.shorten(str(error), 200)
            log.warning("updates run without a CUDA graph, since they cannot be recorded: %s", reason)


def record(
    compute: Callable[[], tuple[dict[str, Tensor], Tensor]],
    generator: torch.Generator,
    stream: torch.cuda.Stream | None,
) -> Recording:
    """Record `compute` as a CUDA graph; raises RuntimeError if that is not possible."""
    graph = torch.cuda.CUDAGraph()
    graph.register_generator_state(generator)
    # Other threads may use the GPU at the same time: a checkpoint is copied from it by another thread.
    with torch.cuda.graph(graph, stream=stream, capture_error_mode="thread_local"):
        metrics, errors = compute()
        together = torch.stack([value.float() for value in metrics.values()])
    return Recording(graph.replay, list(metrics), together, errors)


class Recording:
    """A recorded update and its outputs: metrics float32 [names], errors float32 [items]."""

    def __init__(
        self, replay: Callable[[], object], names: list[str], metrics: Tensor, errors: Tensor
    ) -> None:
        self._replay, self._names, self._metrics, self._errors = replay, names, metrics, errors

    def play(self) -> tuple[dict[str, Tensor], Tensor]:
        """Replay the update; the results are copies, since the next replay overwrites them."""
        self._replay()
        return dict(zip(self._names, self._metrics.clone().unbind(), strict=True)), self._errors.clone()


def _tensors(data: TrainingBatch) -> Iterator[Tensor]:
    """All tensors of a batch of constant shapes, in a fixed order."""
    assert isinstance(data.frames, TransitionFrames | PaddedFrames)
    yield from data.frames.tensors()
    yield data.item_of
    yield from data.states.values()
    for level in data.levels.values():
        yield from (level.taken, level.reward, level.discount, level.weights)
        yield from (tensor for tensor in (level.held, level.in_force) if tensor is not None)


def _of_tensors(data: TrainingBatch, tensors: Iterator[Tensor]) -> TrainingBatch:
    """A batch like `data` of other tensors, in the order of `_tensors`."""
    assert isinstance(data.frames, TransitionFrames | PaddedFrames)

    def level(like: LevelData) -> LevelData:
        return replace(
            like,
            taken=next(tensors),
            reward=next(tensors),
            discount=next(tensors),
            weights=next(tensors),
            held=None if like.held is None else next(tensors),
            in_force=None if like.in_force is None else next(tensors),
        )

    return replace(
        data,
        frames=data.frames.of(tensors),
        item_of=next(tensors),
        states={name: next(tensors) for name in data.states},
        levels={name: level(like) for name, like in data.levels.items()},
    )
