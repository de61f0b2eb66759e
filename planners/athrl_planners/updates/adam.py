"""Adam for a fixed list of parameters, with torch's fused kernel.

`torch.optim.Adam` computes the same, bit for bit (a test compares them). But it imports torch's compiler with
sympy and triton, which are not used here: 1.4 s of a learner's start, and so of its restart after a kill, and
140 MiB of its memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from torch import Tensor
from torch.optim.adam import adam

_BETAS = (0.9, 0.999)
_EPSILON = 1e-8
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


class Adam:
    """Moments and steps of each parameter; the names are those of `torch.optim.Adam`."""

    def __init__(self, parameters: Iterable[Tensor], learning_rate: float) -> None:
        self._parameters = list(parameters)
        self._learning_rate = learning_rate
        self._state = [_fresh(parameter) for parameter in self._parameters]

    @torch.no_grad()
    def step(self, learning_rate: float | Tensor | None = None) -> None:
        """Apply existing gradients and clear them, with another step size if one is given.

        A tensor, float [], is read when the kernel runs, so a recorded step can change its step size.
        """
        moving = [
            (parameter, parameter.grad, state)
            for parameter, state in zip(self._parameters, self._state, strict=True)
            if parameter.grad is not None
        ]
        adam(
            [parameter for parameter, _, _ in moving],
            [gradient for _, gradient, _ in moving],
            [state["exp_avg"] for _, _, state in moving],
            [state["exp_avg_sq"] for _, _, state in moving],
            [],
            [state["step"] for _, _, state in moving],
            fused=True,
            amsgrad=False,
            beta1=_BETAS[0],
            beta2=_BETAS[1],
            lr=self._learning_rate if learning_rate is None else learning_rate,
            weight_decay=0.0,
            eps=_EPSILON,
            maximize=False,
        )
        for parameter, _, _ in moving:
            parameter.grad = None

    def state_dict(self) -> dict[str, Any]:
        """`state` as in `torch.optim.Adam`, by index of the parameter; the tensors are not copied."""
        return {"state": {place: dict(state) for place, state in enumerate(self._state)}}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from a state of this class or of `torch.optim.Adam`, which is empty before its first step.

        Raises:
            ValueError: it belongs to other parameters.
        """
        self.require_fitting(state)
        moments = self._moments(state)
        for place, (parameter, own) in enumerate(zip(self._parameters, self._state, strict=True)):
            for name in _MOMENTS:
                own[name] = moments[place][name].detach().clone().to(parameter.device)

    def require_fitting(self, state: Mapping[str, Any]) -> None:
        """Check a state without loading it; raises ValueError if it belongs to other parameters."""
        moments = self._moments(state)
        if set(moments) != set(range(len(self._parameters))):
            raise ValueError(
                f"the optimiser's state is of {len(moments)} parameters, not {len(self._parameters)}"
            )
        for place, own in enumerate(self._state):
            for name in _MOMENTS:
                shape = own[name].shape
                if moments[place][name].shape != shape:
                    raise ValueError(
                        f"the optimiser's {name} of parameter {place} has shape "
                        f"{list(moments[place][name].shape)}; it should be {list(shape)}"
                    )

    def _moments(self, state: Mapping[str, Any]) -> Mapping[int, Mapping[str, Tensor]]:
        """The moments in a state by index of the parameter."""
        return state["state"] or dict(enumerate(map(_fresh, self._parameters)))


def _fresh(parameter: Tensor) -> dict[str, Tensor]:
    return {
        "step": torch.zeros((), dtype=torch.float32, device=parameter.device),
        "exp_avg": torch.zeros_like(parameter, memory_format=torch.preserve_format),
        "exp_avg_sq": torch.zeros_like(parameter, memory_format=torch.preserve_format),
    }
