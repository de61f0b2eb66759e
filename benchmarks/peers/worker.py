"""A peer in a separate process: `python -m benchmarks.peers.worker PEER COMPARISON FILE`."""

from __future__ import annotations

import importlib
import json
import sys
import warnings
from pathlib import Path

PEERS = {
    "sb3_ppo": "stable_baselines:train_ppo",
    "sb3_td3": "stable_baselines:train_td3",
    "sb3_sac": "stable_baselines:train_sac",
    "torchrl_ppo": "torchrl_ppo:train",
    "rllib_ppo": "rllib_ppo:train",
}
"""Module and function of each, which trains for its time and returns its settings."""


def main() -> None:
    """Train one peer and write the result."""
    warnings.simplefilter("ignore")
    import torch

    from benchmarks.peers.comparison import Comparison, Learned, Training
    from benchmarks.peers.town import Examination

    peer, given, file = sys.argv[1:]
    comparison = Comparison(**json.loads(given))
    torch.set_num_threads(comparison.cores)
    torch.manual_seed(comparison.seed)
    module, _, function = PEERS[peer].partition(":")
    train = getattr(importlib.import_module(f"benchmarks.peers.{module}"), function)
    training = Training(comparison, Examination(comparison).score)
    settings = train(training)
    Learned(comparison, training.points, settings).write(Path(file))


if __name__ == "__main__":
    main()
