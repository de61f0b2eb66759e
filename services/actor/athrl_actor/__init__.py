"""Drives environments with the newest policy and streams the experience."""

from athrl_actor.actor import run_actor
from athrl_actor.failures import ActorError, TooManyFailures

__all__ = ["ActorError", "TooManyFailures", "run_actor"]
