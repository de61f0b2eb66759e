"""Noise in updates: one generator for each thread that computes a part of an update."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import torch
from torch import Tensor


class NoiseSource:
    """Standard normal numbers, with a separate generator for each part of an update.

    Args:
        seed: equal seeds give equal noise.
        device: device of the numbers.
        parts: number of parts of an update.
    """

    def __init__(self, seed: int, device: torch.device, parts: int = 1) -> None:
        self.generators = [torch.Generator(device).manual_seed(seed + part) for part in range(parts)]
        self._thread = threading.local()

    def use(self, part: int) -> None:
        """Use the generator of this part in the calling thread from now on; by default that of the first."""
        self._thread.part = part

    def normal_like(self, tensor: Tensor) -> Tensor:
        """Standard normal numbers of a tensor's shape."""
        generator = self.generators[getattr(self._thread, "part", 0)]
        return torch.randn(tensor.shape, generator=generator, device=tensor.device)

    def state(self) -> list[Tensor]:
        """State for `load_state`."""
        return [generator.get_state() for generator in self.generators]

    def load_state(self, states: Sequence[Tensor], otherwise: int) -> None:
        """Continue from `state()`; with another number of parts or kind of device, use a seed instead."""
        own = self.generators
        same = len(states) == len(own) and all(
            state.shape == generator.get_state().shape for state, generator in zip(states, own, strict=True)
        )
        for part, generator in enumerate(own):
            if same:
                generator.set_state(states[part].cpu())
            else:
                generator.manual_seed(generator.initial_seed() + otherwise)
