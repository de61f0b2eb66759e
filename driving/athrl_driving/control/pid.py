"""A PID controller that remembers its integral and its last error until it is reset."""

from __future__ import annotations


class Pid:
    """Proportional, derivative and integral control with a symmetric limit.

    The integral only grows while the output is within the limit or the error pulls it back (conditional
    integration), so standing on the limit does not wind it up.
    """

    def __init__(self, proportional: float, derivative: float, integral: float, limit: float) -> None:
        self.proportional = proportional
        self.derivative = derivative
        self.integral = integral
        self.limit = limit
        self.reset()

    def reset(self) -> None:
        """Forget the past: at the start of an episode, and only there."""
        self.error_sum = 0.0
        self.last_error: float | None = None

    def step(self, error: float, interval: float) -> float:
        """Output for `error`, `interval` seconds after the last call.

        The derivative is 0 at the first call after a reset.
        """
        slope = 0.0 if self.last_error is None else (error - self.last_error) / interval
        self.last_error = error
        error_sum = self.error_sum + error * interval
        output = self.proportional * error + self.derivative * slope + self.integral * error_sum
        if abs(output) <= self.limit or output * error < 0:
            self.error_sum = error_sum
        return min(max(output, -self.limit), self.limit)
