"""Updates on a GPU as two recorded graphs, one with and one without the actors' step.

An update is some hundred small kernels, and launching them one by one takes longer than running them. So the
update reads its batch and its step size from buffers that stay where they are, is recorded once as a CUDA
graph, and played back from then on. Only batches of transitions have shapes that never change; whole
sequences are trained as they come. Where recording fails, or on a CPU, the same updates run one by one.

No GPU was at hand when this was written: of the recording itself only the way around it has been run, and
its twin without a recording, on a CPU, where a test holds it to equal results.
"""

from __future__ import annotations

import logging
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import replace

import torch
from torch import Tensor

from athrl_planners.training_batch import LevelData, TrainingBatch, TransitionFrames

log = logging.getLogger(__name__)

Compute = Callable[[TrainingBatch, Tensor, bool], tuple[dict[str, Tensor], Tensor]]
"""An update without its counter: of a batch and a step size float [], with or without the actors' step."""

WARM_UP = 3
"""Updates of each kind before it is recorded: libraries get their memory ready in the first ones."""


class CapturedUpdate:
    """Runs updates out of buffers that stay where they are, recorded where there is a GPU.

    Args:
        compute: the update; it allocates and launches, and waits for nothing.
        parameters: that have gradients while it runs.
        generator: draws the noise in it.
        device: where it runs.
    """

    def __init__(
        self, compute: Compute, parameters: list[Tensor], generator: torch.Generator, device: torch.device
    ) -> None:
        self._compute, self._parameters, self._generator = compute, parameters, generator
        self._records = device.type == "cuda"
        self._stream = torch.cuda.Stream(device) if self._records else None
        # On a GPU Adam takes float32 alone; on a CPU it takes what a plain number would be.
        dtype = torch.float32 if self._records else torch.float64
        self._rate = torch.zeros((), dtype=dtype, device=device)
        self._batch: TrainingBatch | None = None
        self._buffers: list[Tensor] = []
        self._recordings: dict[bool, Recording] = {}
        self._runs = {False: 0, True: 0}

    @staticmethod
    def takes(data: TrainingBatch) -> bool:
        """Whether a batch has the shapes of every other one of its kind."""
        return isinstance(data.frames, TransitionFrames)

    def __call__(
        self, data: TrainingBatch, rate: float, with_actors: bool
    ) -> tuple[dict[str, Tensor], Tensor]:
        """Do one update; results as of `compute`, in memory of their own."""
        batch = self._take(data)
        self._rate.fill_(rate)
        if self._records and with_actors not in self._recordings and self._runs[with_actors] >= WARM_UP:
            self._record(batch, with_actors)
        if with_actors in self._recordings:
            return self._recordings[with_actors].play()
        self._runs[with_actors] += 1
        return self._run(batch, with_actors)

    def _take(self, data: TrainingBatch) -> TrainingBatch:
        """The batch in the buffers; one of other shapes gets new ones, and new recordings."""
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
        # On the stream that records later, as torch asks for.
        self._stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(self._stream):
            results = self._compute(batch, self._rate, with_actors)
        torch.cuda.current_stream().wait_stream(self._stream)
        return results

    def _record(self, batch: TrainingBatch, with_actors: bool) -> None:
        """Record an update, which runs nothing; should it fail, there is a warning and no further try."""
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
            log.warning("updates run one by one, since they cannot be recorded as a CUDA graph: %s", reason)


def record(
    compute: Callable[[], tuple[dict[str, Tensor], Tensor]],
    generator: torch.Generator,
    stream: torch.cuda.Stream | None,
) -> Recording:
    """What `compute` launches, as a CUDA graph; raises RuntimeError where it does what no graph can hold."""
    graph = torch.cuda.CUDAGraph()
    graph.register_generator_state(generator)
    # Others may use the GPU meanwhile: a checkpoint is read off it by a thread of its own.
    with torch.cuda.graph(graph, stream=stream, capture_error_mode="thread_local"):
        metrics, errors = compute()
        together = torch.stack([value.float() for value in metrics.values()])
    return Recording(graph.replay, list(metrics), together, errors)


class Recording:
    """A recorded update and where it leaves its results: metrics float32 [names], errors float32 [pieces]."""

    def __init__(
        self, replay: Callable[[], object], names: list[str], metrics: Tensor, errors: Tensor
    ) -> None:
        self._replay, self._names, self._metrics, self._errors = replay, names, metrics, errors

    def play(self) -> tuple[dict[str, Tensor], Tensor]:
        """Run it; the results are copies, since the next time they are overwritten."""
        self._replay()
        return dict(zip(self._names, self._metrics.clone().unbind(), strict=True)), self._errors.clone()


def _tensors(data: TrainingBatch) -> Iterator[Tensor]:
    """All tensors of a batch of transitions, in a fixed order."""
    assert isinstance(data.frames, TransitionFrames)
    yield from (data.frames.images, data.frames.motion, data.rows)
    for level in data.levels.values():
        yield from (level.taken, level.reward, level.discount, level.weights)
        yield from (tensor for tensor in (level.held, level.in_force) if tensor is not None)


def _of_tensors(data: TrainingBatch, tensors: Iterator[Tensor]) -> TrainingBatch:
    """A batch like `data` of other tensors, in the order of `_tensors`."""
    images, motion, rows = next(tensors), next(tensors), next(tensors)

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

    levels = {name: level(like) for name, like in data.levels.items()}
    return replace(data, frames=TransitionFrames(images, motion), rows=rows, levels=levels)
