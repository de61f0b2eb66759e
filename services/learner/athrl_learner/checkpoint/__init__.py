"""Checkpoints: one folder each, written under another name and renamed, with a checksum of every file.

    checkpoints/checkpoint-000007/
        manifest.json     format version, checksums, the segments of the log that hold the replay
        state.json        run file, counters, limiter, ledger, random states of the learner
        agent.pt          both planners: weights, targets, optimisers, averages
        actor.pt          of serial runs only: environments, noise, recurrent states, open chunks, policy

Nothing in it is ever unpickled: JSON and `torch.load(weights_only=True)`.
"""

from athrl_learner.checkpoint.content import CheckpointContent
from athrl_learner.checkpoint.reading import newest_intact_checkpoint, read_checkpoint
from athrl_learner.checkpoint.retention import BestCheckpoint, remove_unfinished, remove_unneeded
from athrl_learner.checkpoint.writing import write_checkpoint

__all__ = [
    "BestCheckpoint",
    "CheckpointContent",
    "newest_intact_checkpoint",
    "read_checkpoint",
    "remove_unfinished",
    "remove_unneeded",
    "write_checkpoint",
]
