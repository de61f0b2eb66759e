"""Memories over sequences of features; the state of each is one vector."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional


class Lstm(nn.LSTM):
    """One LSTM layer whose state is one vector: output and cell concatenated."""

    def __init__(self, inputs: int, units: int) -> None:
        super().__init__(inputs, units)
        with torch.no_grad():  # an open forget gate remembers from the first update on
            self.get_parameter("bias_ih_l0")[units : 2 * units] = 1.0

    @property
    def state_size(self) -> int:
        """Numbers in the state."""
        return 2 * self.hidden_size

    def unroll(self, features: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """[time, batch, inputs] and [batch, state] -> [time, batch, units] and the last state."""
        output, cell = state.unsqueeze(0).split(self.hidden_size, dim=2)
        outputs, (output, cell) = self(features, (output.contiguous(), cell.contiguous()))
        return outputs, torch.cat((output, cell), dim=2).squeeze(0)

    def step(self, features: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """One step, [batch, inputs] and [batch, state] -> [batch, units] and the next state.

        It computes the same as `unroll` with the same weights by name, as an exported graph needs to replace
        them.
        """
        output, cell = state.split(self.hidden_size, dim=1)
        gates = self._gates("ih", features) + self._gates("hh", output)
        enter, forget, fresh, leave = gates.chunk(4, dim=1)
        cell = torch.sigmoid(forget) * cell + torch.sigmoid(enter) * torch.tanh(fresh)
        output = torch.sigmoid(leave) * torch.tanh(cell)
        return output, torch.cat((output, cell), dim=1)

    def _gates(self, part: str, inputs: Tensor) -> Tensor:
        weight, bias = (self.get_parameter(f"{name}_{part}_l0") for name in ("weight", "bias"))
        return functional.linear(inputs, weight, bias)


Memory = Lstm


def make_memory(kind: str, inputs: int, units: int) -> Memory | None:
    """The memory that `settings.memory` names; None without one."""
    return Lstm(inputs, units) if kind == "lstm" else None
