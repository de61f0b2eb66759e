"""The command: train, evaluate, watch and see the state of a run."""

from athrl.command import main

__all__ = ["main"]
