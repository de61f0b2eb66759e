"""Drives environments with the newest policy and streams what happens."""

from athrl_actor.actor import run_actor

__all__ = ["run_actor"]
