"""Replay, limiter and step counter behind one lock: where the intake thread and the trainer meet."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from athrl_planners import SequenceBatch, SequenceReplay
from athrl_protocol import Chunk, IntakeBusy, IntakeFinished

from athrl_learner.arrivals import Arrivals
from athrl_learner.experience import ChunkReader
from athrl_learner.limiter import SamplesPerInsert
from athrl_learner.waiting import WaitingTime


class ExperienceStore:
    """Takes chunks in and hands batches out, as far as the limiter permits."""

    def __init__(
        self,
        reader: ChunkReader,
        replay: SequenceReplay,
        limiter: SamplesPerInsert,
        arrivals: Arrivals,
        environment_steps_target: int,
    ) -> None:
        self.replay = replay
        self.limiter = limiter
        self.environment_steps_target = environment_steps_target
        self.environment_steps = 0  # transitions accepted, each counted here and nowhere else
        self.actors_waiting = WaitingTime()
        self.learner_waiting = WaitingTime()
        self._reader = reader
        self._arrivals = arrivals
        self._changed = threading.Condition()

    @property
    def complete(self) -> bool:
        """Whether all environment steps of the run are in."""
        return self.environment_steps >= self.environment_steps_target

    def exhausted(self, sequences: int) -> bool:
        """Whether all experience is in and no more batches of `sequences` are owed."""
        return self.complete and not self.limiter.permits_sample(sequences * self.replay.sequence_length)

    def accept(self, chunk: Chunk) -> None:
        """Check a chunk and put it into the replay. Called by the intake, on its thread.

        Raises:
            InvalidMessage: the chunk does not fit the run.
            IntakeBusy: training lags too far behind; the actor has to wait.
            IntakeFinished: the run has all its environment steps.
        """
        sequence = self._reader.sequence(chunk)
        with self._changed:
            if self.complete:
                raise IntakeFinished("the run has all its environment steps")
            if not self.limiter.permits_insert(chunk.length):
                self.actors_waiting.begin()
                raise IntakeBusy(self.limiter.explain() or "the learner is busy")
            self.actors_waiting.end()
            self.replay.insert(sequence)
            self.limiter.inserted(chunk.length)
            self.environment_steps += chunk.length
            self._arrivals.arrived(chunk)
            if self.complete:
                self.limiter.close()
            self._changed.notify_all()

    def sample(self, sequences: int, timeout: float) -> SequenceBatch | None:
        """A batch as soon as the limiter permits it, or None after `timeout` seconds without permission.

        With all experience in, None comes at once when nothing more is owed.
        """
        largest = sequences * self.replay.sequence_length
        with self._changed:
            if not self.limiter.permits_sample(largest):
                self.learner_waiting.begin()
                self._changed.wait_for(
                    lambda: self.complete or self.limiter.permits_sample(largest), timeout=timeout
                )
                if not self.limiter.permits_sample(largest):
                    return None
            self.learner_waiting.end()
            batch = self.replay.sample(sequences)
            self.limiter.sampled(batch.transitions)
            if self.limiter.permits_insert(self.limiter.largest_insert):
                self.actors_waiting.end()
            return batch

    @contextmanager
    def held(self) -> Iterator[None]:
        """Nothing is inserted or sampled inside the block: for a consistent snapshot."""
        with self._changed:
            yield

    def restore(self, environment_steps: int) -> None:
        """Go on from `environment_steps`, after replay and limiter were restored."""
        with self._changed:
            self.environment_steps = environment_steps
            if self.complete:
                self.limiter.close()
