"""A PID controller that remembers its integral and its last error until it is reset."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from athrl_driving.kernels.compilation import compiled

ERROR_SUM, LAST_ERROR = 0, 1
"""Places in a controller's memory, float64 [2]; the last error is NaN before the first step."""


@compiled
def pid_step(
    memory: NDArray[np.float64],
    proportional: float,
    derivative: float,
    integral: float,
    limit: float,
    error: float,
    interval: float,
) -> float:
    """Output for `error`, `interval` seconds after the last call; see `Pid`."""
    slope = 0.0 if math.isnan(memory[LAST_ERROR]) else (error - memory[LAST_ERROR]) / interval
    memory[LAST_ERROR] = error
    error_sum = memory[ERROR_SUM] + error * interval
    output = proportional * error + derivative * slope + integral * error_sum
    if abs(output) <= limit or output * error < 0:
        memory[ERROR_SUM] = error_sum
    return min(max(output, -limit), limit)


@compiled
def forget(memory: NDArray[np.float64]) -> None:
    """Clear a controller's memory."""
    memory[ERROR_SUM] = 0.0
    memory[LAST_ERROR] = math.nan


class Pid:
    """Proportional, derivative and integral control with a symmetric limit.

    The integral only grows while the output is within the limit or the error reduces it (conditional
    integration), so it does not wind up at the limit.

    `memory`, float64 [2], holds integral and last error; an environment's controllers use views of its state.
    """

    def __init__(
        self,
        proportional: float,
        derivative: float,
        integral: float,
        limit: float,
        memory: NDArray[np.float64] | None = None,
    ) -> None:
        self.proportional = proportional
        self.derivative = derivative
        self.integral = integral
        self.limit = limit
        self.memory = np.array([0.0, math.nan]) if memory is None else memory

    @property
    def error_sum(self) -> float:
        """The integral of the error."""
        return float(self.memory[ERROR_SUM])

    @property
    def last_error(self) -> float | None:
        """The error of the last step; None before the first one."""
        error = float(self.memory[LAST_ERROR])
        return None if math.isnan(error) else error

    def reset(self) -> None:
        """Clear the memory; only at the start of an episode."""
        forget(self.memory)

    def step(self, error: float, interval: float) -> float:
        """Output for `error`, `interval` seconds after the last call.

        The derivative is 0 at the first call after a reset.
        """
        gains = (self.proportional, self.derivative, self.integral, self.limit)
        return pid_step(self.memory, *gains, float(error), float(interval))
