"""Precision of updates: bfloat16 if the processor is faster with it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import NamedTuple

import torch
from torch import nn

WORTH_IT = 1.05
"""How many times as fast bfloat16 must be, as measurements vary and float32 is more exact."""

_ROUNDS = 6
_IMAGES = 256


class Measured(NamedTuple):
    """The faster precision and its speed."""

    precision: torch.dtype
    speed: float
    """Speed of bfloat16 as a multiple of float32's; 0 if it was not measured."""


def autocast(device: torch.device, precision: torch.dtype) -> AbstractContextManager:
    """Context in which matrix products and convolutions use `precision`; nothing else changes."""
    if precision == torch.float32:
        return contextlib.nullcontext()
    # No cache: weights cast without gradient would be reused where a gradient is needed.
    return torch.autocast(device.type, precision, cache_enabled=False)


def faster_precision(device: torch.device) -> Measured:
    """The faster of float32 and bfloat16 for small networks on this device.

    On a CPU it is measured within half a second, on one thread and in processor time, on which other
    processes have no effect; a GPU with bfloat16 is faster with it.
    """
    if device.type != "cpu":
        return Measured(torch.bfloat16 if torch.cuda.is_bf16_supported() else torch.float32, 0.0)
    best = dict.fromkeys((torch.float32, torch.bfloat16), float("inf"))
    with torch.random.fork_rng(devices=[]), _one_thread():
        layers = _small_network().to(memory_format=torch.channels_last)
        images = torch.randn(_IMAGES, 32, 32, 4).permute(0, 3, 1, 2)
        for _ in range(_ROUNDS):
            for precision in best:
                best[precision] = min(best[precision], _seconds(layers, images, precision))
    speed = best[torch.float32] / best[torch.bfloat16]
    return Measured(torch.bfloat16 if speed >= WORTH_IT else torch.float32, speed)


def _small_network() -> nn.Module:
    """Layers of the sizes that planners have."""
    return nn.Sequential(
        nn.Conv2d(4, 16, 3, 2, 1),
        nn.ReLU(),
        nn.Conv2d(16, 32, 3, 2, 1),
        nn.ReLU(),
        nn.Conv2d(32, 64, 3, 2, 1),
        nn.ReLU(),
        nn.Flatten(),
        nn.Linear(1024, 256),
    )


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _seconds(layers: nn.Module, images: torch.Tensor, precision: torch.dtype) -> float:
    """Seconds of one forward and backward pass."""
    began = time.thread_time()
    with autocast(images.device, precision):
        output = layers(images)
    output.float().square().mean().backward()
    return time.thread_time() - began
