"""Checkpoints: one folder each, written beside and renamed, with a checksum of every file.

    checkpoints/checkpoint-000007/
        manifest.json     format version, size and sha256 of every other file
        state.json        run file, counters, limiter, ledger, random states of the learner
        agent.pt          both planners: weights, targets, optimisers, averages
        replay/*.npy.zst  the replay's columns

Nothing in it is ever unpickled: JSON, `torch.load(weights_only=True)` and `allow_pickle=False`.
"""

from athrl_learner.checkpoint.content import CheckpointContent
from athrl_learner.checkpoint.reading import newest_intact_checkpoint, read_checkpoint
from athrl_learner.checkpoint.writing import remove_unfinished, write_checkpoint

__all__ = [
    "CheckpointContent",
    "newest_intact_checkpoint",
    "read_checkpoint",
    "remove_unfinished",
    "write_checkpoint",
]
