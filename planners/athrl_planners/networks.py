"""The networks of one level: a trunk that sees and remembers, an actor and critics on top of it.

The paper gives actor and critic an encoder and an LSTM each. Here they share one trunk, which learns from the
critics' loss alone; the actor reads it without changing it. That is about three times cheaper. What a level
above has decided (the intention) and the action enter after the LSTM, so that asking about another intention
costs only the small networks on top.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from athrl_planners.settings import ObservationSettings

CHANNELS = (16, 32, 64)  # of the three convolutions, each halving the image


def as_pixels(images: Tensor) -> Tensor:
    """uint8 [n, height, width, channels] -> float32 [n, channels, height, width] in 0..1.

    The memory stays in the order of the images, which torch calls channels_last: nothing is moved.
    """
    return images.permute(0, 3, 1, 2).float().mul_(1 / 255)


class Trunk(nn.Module):
    """Encoder -> dense layer -> LSTM. It hands on the dense layer's output beside the LSTM's: the context."""

    def __init__(self, observation: ObservationSettings, hidden: int, recurrent: int) -> None:
        super().__init__()
        self.recurrent = recurrent
        self.encoder = nn.Sequential()
        channels, size = observation.image_channels, observation.image_size
        for width in CHANNELS:
            self.encoder.append(nn.Conv2d(channels, width, kernel_size=3, stride=2, padding=1))
            self.encoder.append(nn.ReLU(inplace=True))
            channels, size = width, (size + 1) // 2
        self.encoder.append(nn.Flatten())
        self.encoder.append(nn.LayerNorm(channels * size * size))
        self.dense = nn.Sequential(
            nn.Linear(channels * size * size + observation.motion_size, hidden),
            nn.LayerNorm(hidden),
            nn.ReLU(),
        )
        self.lstm = nn.LSTM(hidden, recurrent)
        with torch.no_grad():  # a forget gate that starts open remembers from the first update on
            self.lstm.get_parameter("bias_ih_l0")[recurrent : 2 * recurrent] = 1.0

    @property
    def context_size(self) -> int:
        """Features of the context."""
        return self.lstm.input_size + self.recurrent

    @property
    def state_size(self) -> int:
        """Numbers in the recurrent state: the LSTM's output and its cell."""
        return 2 * self.recurrent

    def features(self, pixels: Tensor, motion: Tensor) -> Tensor:
        """Encode observations: pixels [n, channels, height, width], motion [n, motion] -> [n, hidden]."""
        return self.dense(torch.cat((self.encoder(pixels), motion), dim=1))

    def unroll(self, features: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Remember: features [time, batch, hidden], state [batch, state] -> [time, batch, context], state."""
        output, cell = state.unsqueeze(0).split(self.recurrent, dim=2)
        outputs, (output, cell) = self.lstm(features, (output.contiguous(), cell.contiguous()))
        return torch.cat((features, outputs), dim=2), torch.cat((output, cell), dim=2).squeeze(0)


class Actor(nn.Module):
    """Context (and what was decided above) -> action before its tanh."""

    def __init__(self, inputs: int, hidden: int, actions: int) -> None:
        super().__init__()
        last = nn.Linear(hidden, actions)
        nn.init.uniform_(last.weight, -3e-3, 3e-3)  # starts in the middle of the ranges, far from saturation
        nn.init.zeros_(last.bias)
        self.layers = nn.Sequential(nn.Linear(inputs, hidden), nn.LayerNorm(hidden), nn.ReLU(), last)

    def forward(self, context: Tensor, above: Tensor | None) -> Tensor:
        """[n, context], normalised [n, above] or none -> [n, actions], unbounded; tanh makes it an action."""
        return self.layers(context if above is None else torch.cat((context, above), dim=1))


class Critic(nn.Module):
    """Context, what was decided above, action -> value."""

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(inputs, hidden),
            nn.LayerNorm(hidden),
            nn.ReLU(),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
            nn.Linear(hidden, 1),
        )

    def forward(self, context: Tensor, above: Tensor | None, action: Tensor) -> Tensor:
        """[n, context], normalised [n, above] or none, normalised [n, actions] -> [n], in scaled reward."""
        inputs = (context, action) if above is None else (context, above, action)
        return self.layers(torch.cat(inputs, dim=1)).squeeze(1)
