"""The image encoders at every size of image that a run file allows, in every precision of updates."""

from __future__ import annotations

import pytest
import torch
from athrl_planners.networks import make_encoder
from athrl_planners.training.precision import autocast
from athrl_spaces import Observation
from torch import Tensor, nn


def spoil_freed_memory(parameters: list[Tensor], precision: torch.dtype) -> None:
    """Fill memory that gradients of these sizes will get, so that what they leave unwritten shows."""
    spoilt = [torch.full_like(each, float("nan"), dtype=precision) for each in parameters for _ in range(4)]
    del spoilt


def gradient(encoder: nn.Module, pixels: Tensor, precision: torch.dtype) -> tuple[Tensor, ...]:
    parameters = list(encoder.parameters())
    with autocast(torch.device("cpu"), precision):
        features = encoder(pixels.to(precision))
    spoil_freed_memory(parameters, precision)
    return torch.autograd.grad(features.float().square().sum(), parameters)


@pytest.mark.parametrize("kind", ["small", "paper"])
@pytest.mark.parametrize("size", [8, 9, 16, 17])
def test_gradient_in_bfloat16_is_that_in_float32(kind: str, size: int) -> None:
    torch.manual_seed(1)
    observation = Observation(size)
    encoder = make_encoder(kind, observation).to(memory_format=torch.channels_last)
    pixels = torch.randint(0, 256, (40, len(observation.channels), size, size)).float()
    pixels = pixels.to(memory_format=torch.channels_last)
    exact = gradient(encoder, pixels, torch.float32)
    for _ in range(4):
        for rounded, wanted in zip(gradient(encoder, pixels, torch.bfloat16), exact, strict=True):
            assert (rounded - wanted).norm() <= 0.05 * wanted.norm()
