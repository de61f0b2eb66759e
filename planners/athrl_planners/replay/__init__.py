"""Experience replay: a ring buffer of sequences, and sampled batches."""

from athrl_planners.replay.batches import Batch, Decisions, Sequence, SequenceBatch, TransitionBatch
from athrl_planners.replay.sequences import SequenceReplay

__all__ = ["Batch", "Decisions", "Sequence", "SequenceBatch", "SequenceReplay", "TransitionBatch"]
