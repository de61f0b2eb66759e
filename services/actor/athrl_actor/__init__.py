"""Drives environments with the newest policy and streams what happens."""

from athrl_actor.actor import run_actor
from athrl_actor.joining import NameTaken

__all__ = ["NameTaken", "run_actor"]
