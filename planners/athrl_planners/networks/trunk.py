"""A trunk: encoder and memory. Its output is the context, the input of actors and critics.

In the paper every actor and critic has its own encoder and LSTM. Here they share a trunk that only learns
from the critics' loss; actors use it without changing it. Decisions of levels above and the action enter
after the trunk, so evaluating another intention only costs the small heads.
"""

from __future__ import annotations

import torch
from athrl_spaces import Observation
from torch import Tensor, nn

from athrl_planners.networks.encoders import make_encoder
from athrl_planners.networks.memory import make_memory
from athrl_planners.planner import View
from athrl_planners.settings import PlannerSettings

ROUTE, DRIVABLE = "route", "drivable"
NEAR = 0.125
"""Share of the image's height, from the ego up, in which the near route is visible."""
EGO_HEIGHT = 0.625
"""Position of the ego in the image, as a share of its height from the top."""


def as_pixels(images: Tensor) -> Tensor:
    """uint8 [n, height, width, channels] -> [n, channels, height, width], 0..255, in the dtype of
    convolutions.

    The memory layout stays that of the images, which torch calls channels_last: nothing is copied. bfloat16
    represents integers up to 256 exactly.
    """
    device = images.device.type
    dtype = torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else torch.float32
    return images.permute(0, 3, 1, 2).to(dtype)


class Trunk(nn.Module):
    """Encoder, a dense layer that joins image and motion, and an optional memory."""

    mask: Tensor | None

    def __init__(self, settings: PlannerSettings, observation: Observation, view: View) -> None:
        super().__init__()
        self.encoder = make_encoder(settings.encoder, observation)
        hidden = settings.hidden_features
        self.dense = nn.Sequential(
            nn.Linear(self.encoder.features + observation.motion_size, hidden),
            nn.LayerNorm(hidden),
            nn.ReLU(),
        )
        self.memory = make_memory(settings.memory, hidden, settings.recurrent_features)
        self.context_size = hidden + (self.memory.hidden_size if self.memory else 0)
        self.register_buffer("mask", _mask(view, observation), persistent=False)

    @property
    def state_size(self) -> int:
        """Numbers in the recurrent state; 0 without a memory."""
        return 0 if self.memory is None else self.memory.state_size

    def features(self, pixels: Tensor, motion: Tensor) -> Tensor:
        """Encode observations: pixels [n, channels, height, width], motion [n, motion] -> [n, hidden]."""
        if self.mask is not None:
            pixels = pixels * self.mask
        return self.dense(torch.cat((self.encoder(pixels), motion), dim=1))

    def unroll(self, features: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Apply the memory: [time, batch, hidden], [batch, state] -> [time, batch, context], last state."""
        if self.memory is None:
            return features, state
        outputs, state = self.memory.unroll(features, state)
        return torch.cat((features, outputs), dim=2), state

    def step(self, features: Tensor, state: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """One step: [batch, hidden] and [batch, state] -> [batch, context] and the next state."""
        if self.memory is None or state is None:
            return features, None
        output, state = self.memory.step(features, state)
        return torch.cat((features, output), dim=1), state


def _mask(view: View, observation: Observation) -> Tensor | None:
    """Mask of the visible part of the image, float32 [1, channels, size, size]; None: all of it."""
    if view == "everything":
        return None
    size = observation.image_size
    mask = torch.ones(1, len(observation.channels), size, size)
    route = observation.channels.index(ROUTE)
    if view == "near route":
        mask[:, route, : round((EGO_HEIGHT - NEAR) * size)] = 0
    else:
        kept = (route, observation.channels.index(DRIVABLE))
        for channel in range(len(observation.channels)):
            mask[:, channel] = float(channel in kept)
    return mask
