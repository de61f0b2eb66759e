"""Replay of experience: a ring of sequences, and what is sampled from it."""

from athrl_planners.replay.batches import Batch, Sequence, SequenceBatch, TransitionBatch
from athrl_planners.replay.sequences import SequenceReplay

__all__ = ["Batch", "Sequence", "SequenceBatch", "SequenceReplay", "TransitionBatch"]
