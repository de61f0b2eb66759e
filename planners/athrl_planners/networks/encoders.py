"""Encoders: from images to features."""

from __future__ import annotations

import torch
from athrl_spaces import Observation
from torch import Tensor, nn

SMALL_CHANNELS = (16, 32, 64)
"""Channels of the small encoder's convolutions, each of which halves the image."""

PAPER_LAYERS = ((32, 5, 2), (64, 3, 2), (128, 3, 2), (256, 3, 2))
"""Channels, kernel and stride of the paper's convolutions; a last one reduces the rest to one pixel."""

PAPER_FEATURES = 256
"""Features of each of the paper's towers."""


class PixelConv2d(nn.Conv2d):
    """A convolution that scales pixels 0..255 to 0..1; it scales the weights, which is cheaper."""

    def forward(self, pixels: Tensor) -> Tensor:
        """[n, channels, height, width] -> [n, out_channels, ...]."""
        return self._conv_forward(pixels, self.weight * (1 / 255), self.bias)


class SmallEncoder(nn.Sequential):
    """Three convolutions and a normalisation: pixels [n, channels, size, size] -> [n, features]."""

    def __init__(self, observation: Observation) -> None:
        super().__init__()
        channels, size = len(observation.channels), observation.image_size
        for number, width in enumerate(SMALL_CHANNELS):
            convolution = nn.Conv2d if number else PixelConv2d
            self.append(convolution(channels, width, kernel_size=3, stride=2, padding=1))
            self.append(nn.ReLU(inplace=True))
            channels, size = width, (size + 1) // 2
        self.append(nn.Flatten())
        self.features = channels * size * size
        self.append(nn.LayerNorm(self.features))


class PaperEncoder(nn.Module):
    """Two towers of five convolutions, for the bird's eye view and for the lidar.

    Layers and features are those of the project that the paper builds on (interp-e2e-driving).
    """

    def __init__(self, observation: Observation) -> None:
        super().__init__()
        self.birdeye_channels = len(observation.channels) - 1
        self.birdeye = _tower(self.birdeye_channels, observation.image_size)
        self.lidar = _tower(1, observation.image_size)
        self.features = 2 * PAPER_FEATURES

    def forward(self, pixels: Tensor) -> Tensor:
        """[n, channels, size, size] -> [n, features]; the lidar is the last channel."""
        birdeye, lidar = pixels[:, : self.birdeye_channels], pixels[:, self.birdeye_channels :]
        return torch.cat((self.birdeye(birdeye), self.lidar(lidar)), dim=1)


Encoder = SmallEncoder | PaperEncoder


def make_encoder(kind: str, observation: Observation) -> Encoder:
    """The encoder that `settings.encoder` names."""
    return PaperEncoder(observation) if kind == "paper" else SmallEncoder(observation)


def _tower(channels: int, size: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for number, (width, kernel, stride) in enumerate(PAPER_LAYERS):
        convolution = nn.Conv2d if number else PixelConv2d
        # One pixel gives one pixel with any stride, but with 2 torch's bfloat16 gradient is not finite.
        step = stride if size > 1 else 1
        layers += [
            convolution(channels, width, kernel, step, padding=kernel // 2),
            nn.LeakyReLU(inplace=True),
        ]
        channels, size = width, (size + 1) // 2
    layers += [nn.Conv2d(channels, PAPER_FEATURES, size), nn.LeakyReLU(inplace=True), nn.Flatten()]
    return nn.Sequential(*layers)
