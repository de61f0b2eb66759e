"""highway-env's own traffic, compiled: the same vehicles, rules and results, hundreds of times faster."""

from athrl_accelerate.acceleration import accelerate

__all__ = ["accelerate"]
