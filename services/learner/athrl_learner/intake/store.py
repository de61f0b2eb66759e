"""Replay, log, limiter and step counter behind one lock, shared by the intake thread and the trainer."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import takewhile

from athrl_planners import Batch, Sequence, SequenceReplay
from athrl_protocol import Chunk, IntakeBusy, IntakeFinished

from athrl_learner.errors import Deadlock, DiskFull
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.intake.chunk_validation import ChunkReader
from athrl_learner.intake.limiter import SamplesPerInsert
from athrl_learner.intake.waiting import WaitingTime, waiting_text
from athrl_learner.log import Kind, LogPosition, SegmentLog
from athrl_learner.log.disk_space import DiskSpace


class ExperienceStore:
    """Takes chunks in and returns batches, as far as the limiter permits.

    A chunk is in the log before it is in the replay, so it can be acknowledged when `accept` and `commit`
    have returned.
    """

    def __init__(
        self,
        reader: ChunkReader,
        replay: SequenceReplay,
        limiter: SamplesPerInsert,
        arrivals: Arrivals,
        environment_steps_target: int,
        log: SegmentLog,
        disk_space: DiskSpace | None = None,
    ) -> None:
        self.reader = reader
        self.replay = replay
        self.limiter = limiter
        self.log = log
        self.environment_steps_target = environment_steps_target
        self.environment_steps = 0  # transitions accepted; they are counted only here
        self.actors_waiting = WaitingTime()
        self.learner_waiting = WaitingTime()
        self.disk_space = disk_space or DiskSpace()
        self._arrivals = arrivals
        self._numbers: deque[int] = deque(maxlen=replay.slots)  # record of each sequence in the replay
        self._changed = threading.Condition()

    @property
    def complete(self) -> bool:
        """Whether the run has all its environment steps."""
        return self.environment_steps >= self.environment_steps_target

    @property
    def progress(self) -> float:
        """Share of the run's environment steps that were accepted, 0 to 1."""
        return min(1.0, self.environment_steps / self.environment_steps_target)

    @property
    def exhausted(self) -> bool:
        """Whether all experience is in and no more batches are owed."""
        return self.complete and not self.limiter.permits_sample(self.limiter.largest_sample)

    @property
    def owes_a_batch(self) -> bool:
        """Whether another batch is due for the experience so far."""
        return self.limiter.owes(self.limiter.largest_sample)

    def accept(self, chunk: Chunk, message: bytes) -> None:
        """Validate a chunk, log it and insert it into the replay. Called by the intake, on its thread.

        Args:
            chunk: the decoded chunk.
            message: its bytes as they arrived; the log keeps these.

        Raises:
            InvalidMessage: the chunk does not fit the run.
            IntakeBusy: training lags too far behind, or the disk is full; the actor has to wait.
            IntakeFinished: the run has all its environment steps.
            LogFailed: the log cannot be written any more.
        """
        with self._changed:
            self._require_room()  # first: of what is not taken in now, nothing is checked, refused or logged
        sequences = self.reader.sequences(chunk)
        with self._changed:
            self._require_room()
            number = self._write_down(Kind.CHUNK, message)
            self.actors_waiting.end()
            self._arrivals.arrived(chunk)
            self._take(sequences, number)

    def _require_room(self) -> None:
        """Raise IntakeFinished if the run has all its steps, IntakeBusy if there is no room for a chunk now.

        There has to be room for the largest insert, whatever the length of this one: otherwise short chunks
        would always take the room first, and an actor with a long chunk would wait forever.
        """
        if self.complete:
            raise IntakeFinished("the run has all its environment steps")
        if not self.limiter.permits_insert(self.limiter.largest_insert):
            self.actors_waiting.begin()
            raise IntakeBusy(self.limiter.explain() or "the learner is busy")

    def refuse(self, chunk: Chunk) -> None:
        """Log that a chunk is settled although it was not taken in; raises as `accept` does."""
        numbers = {"actor": chunk.actor, "incarnation": chunk.incarnation, "sequence": chunk.sequence}
        with self._changed:
            self._write_down(Kind.REFUSAL, json.dumps(numbers).encode())

    def commit(self) -> None:
        """Sync the log to the disk before a batch of answers, if so configured; raises LogFailed."""
        self.log.commit()

    def sample(self, timeout: float) -> Batch | None:
        """A batch as soon as the limiter permits it, or None after `timeout` seconds without permission.

        Once all experience has arrived and nothing more is owed, returns None at once.
        """
        largest = self.limiter.largest_sample
        with self._changed:
            if not self.limiter.permits_sample(largest):
                self.learner_waiting.begin()
                self._changed.wait_for(
                    lambda: self.complete or self.limiter.permits_sample(largest), timeout=timeout
                )
                if not self.limiter.permits_sample(largest):
                    return None
            self.learner_waiting.end()
            batch = self.replay.sample(largest)
            self.limiter.sampled(largest)
            if self.limiter.permits_insert(self.limiter.largest_insert) and not self.disk_space.explain():
                self.actors_waiting.end()
            return batch

    def require_progress(self, bound: float) -> None:
        """Check that actors or learner make progress.

        Raises:
            Deadlock: the limiter has kept both actors and learner waiting for `bound` seconds. The limiter
                should prevent that, so it is a bug, and waiting longer would not end it.
        """
        with self._changed:
            lasting = min(self.actors_waiting.lasting, self.learner_waiting.lasting)
            if lasting < bound or self.complete:
                return
            if self.limiter.permits_insert(self.limiter.largest_insert):  # actors wait for the disk, or left
                return
            raise Deadlock(
                f"actors and learner have waited for each other for {lasting:.0f} s: the limiter permits "
                f"neither to continue after {self.limiter.inserts} inserts and {self.limiter.samples} "
                f"samples (surplus {self.limiter.surplus:g}, bound {self.limiter.error_bound:g})"
            )

    def waiting_text(self) -> str:
        """Which side waits, and its share of the last minute; empty if none does. Only within `held`."""
        return self.disk_space.explain() or waiting_text(
            self.limiter,
            self.learner_waiting.share_of_the_minute(),
            self.actors_waiting.share_of_the_minute(),
        )

    @contextmanager
    def held(self) -> Iterator[None]:
        """Within the block nothing is inserted or sampled, for a consistent snapshot."""
        with self._changed:
            yield

    def log_position(self) -> LogPosition:
        """End the log's segment and return that position; only within `held`."""
        segments = self.log.seal()
        oldest = self._numbers[0] if self._numbers else self.log.next_record
        return LogPosition(
            self.log.next_segment,
            self.log.next_record,
            oldest,
            sum(1 for _ in takewhile(lambda number: number == oldest, self._numbers)),
            tuple(facts for facts in segments if facts.first + facts.records > oldest),
        )

    def restore(self, environment_steps: int) -> None:
        """Continue from `environment_steps`, after replay and limiter were restored."""
        with self._changed:
            self.environment_steps = environment_steps
            if self.complete:
                self.limiter.close()

    def add_restored(self, number: int) -> None:
        """Note that a sequence of record `number` was restored into the replay, as its newest."""
        self._numbers.append(number)

    def restore_chunk(self, sequences: list[Sequence], number: int) -> None:
        """Insert the sequences of record `number` of the log, which was accepted after the checkpoint."""
        with self._changed:
            self._take(sequences, number)

    def _take(self, sequences: list[Sequence], number: int) -> None:
        for sequence in sequences:
            self.replay.insert(sequence)
            self._numbers.append(number)
            self.limiter.inserted(sequence.length)
            self.environment_steps += sequence.length
        if self.complete:
            self.limiter.close()
        self._changed.notify_all()

    def _write_down(self, kind: Kind, body: bytes) -> int:
        try:
            number = self.log.append(kind, body)
        except DiskFull as full:
            self.disk_space.report_full(str(full))
            self.actors_waiting.begin()
            raise IntakeBusy(self.disk_space.explain()) from None
        self.disk_space.report_free()
        return number
