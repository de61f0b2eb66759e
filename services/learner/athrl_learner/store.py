"""Replay, log, limiter and step counter behind one lock: where the intake thread and the trainer meet."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import takewhile

from athrl_planners import Batch, Sequence, SequenceReplay
from athrl_protocol import Chunk, IntakeBusy, IntakeFinished

from athrl_learner.arrivals import Arrivals
from athrl_learner.errors import Deadlock, DiskFull
from athrl_learner.experience import ChunkReader
from athrl_learner.limiter import SamplesPerInsert
from athrl_learner.room import DiskRoom
from athrl_learner.segments import Kind, LogPosition, SegmentLog
from athrl_learner.waiting import WaitingTime, waiting_text


class ExperienceStore:
    """Takes chunks in and hands batches out, as far as the limiter permits.

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
        largest_sample: int,
    ) -> None:
        """`largest_sample` decisions are in an update at most."""
        self.reader = reader
        self._largest_sample = largest_sample
        self.replay = replay
        self.limiter = limiter
        self.log = log
        self.environment_steps_target = environment_steps_target
        self.environment_steps = 0  # transitions accepted, each counted here and nowhere else
        self.actors_waiting = WaitingTime()
        self.learner_waiting = WaitingTime()
        self.room = DiskRoom()
        self._arrivals = arrivals
        self._numbers: deque[int] = deque(maxlen=replay.slots)  # of each sequence in the replay: its record
        self._changed = threading.Condition()

    @property
    def complete(self) -> bool:
        """Whether all environment steps of the run are in."""
        return self.environment_steps >= self.environment_steps_target

    @property
    def progress(self) -> float:
        """Share of the run's environment steps that are in, 0 to 1."""
        return min(1.0, self.environment_steps / self.environment_steps_target)

    @property
    def exhausted(self) -> bool:
        """Whether all experience is in and no more batches are owed."""
        return self.complete and not self.limiter.permits_sample(self._largest_sample)

    @property
    def owes_a_batch(self) -> bool:
        """Whether the experience so far asks for another batch."""
        return self.limiter.owes(self._largest_sample)

    def accept(self, chunk: Chunk, message: bytes) -> None:
        """Check a chunk, write it down and put it into the replay. Called by the intake, on its thread.

        Args:
            chunk: what arrived.
            message: as which it arrived; this is what the log keeps.

        Raises:
            InvalidMessage: the chunk does not fit the run.
            IntakeBusy: training lags too far behind, or the disk is full; the actor has to wait.
            IntakeFinished: the run has all its environment steps.
            LogFailed: the disk refuses for good.
        """
        sequences = self.reader.sequences(chunk)
        with self._changed:
            if self.complete:
                raise IntakeFinished("the run has all its environment steps")
            # Room for the largest, whatever this one's length: else short chunks would take every bit of room
            # as it comes, and an actor whose oldest chunk is long would wait for ever.
            if not self.limiter.permits_insert(self.limiter.largest_insert):
                self.actors_waiting.begin()
                raise IntakeBusy(self.limiter.explain() or "the learner is busy")
            number = self._write_down(Kind.CHUNK, message)
            self.actors_waiting.end()
            self._arrivals.arrived(chunk)
            self._take(sequences, number)

    def refuse(self, chunk: Chunk) -> None:
        """Write down that a chunk is settled though it was not taken in; raises as `accept` does."""
        numbers = {"actor": chunk.actor, "incarnation": chunk.incarnation, "sequence": chunk.sequence}
        with self._changed:
            self._write_down(Kind.REFUSAL, json.dumps(numbers).encode())

    def commit(self) -> None:
        """Bring the log to the disk before a batch of answers, if that is wanted; raises LogFailed."""
        self.log.commit()

    def sample(self, timeout: float) -> Batch | None:
        """A batch as soon as the limiter permits it, or None after `timeout` seconds without permission.

        With all experience in, None comes at once when nothing more is owed.
        """
        largest = self._largest_sample
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
            self.limiter.sampled(batch.transitions)
            if self.limiter.permits_insert(self.limiter.largest_insert) and not self.room.explain():
                self.actors_waiting.end()
            return batch

    def require_progress(self, bound: float) -> None:
        """Look whether anybody goes on.

        Raises:
            Deadlock: actors and learner have both been kept waiting by the limiter for `bound` seconds. The
                limiter rules that out, so it is a mistake in the program, and waiting on would not end it.
        """
        with self._changed:
            lasting = min(self.actors_waiting.lasting, self.learner_waiting.lasting)
            if lasting < bound or self.room.explain() or self.complete:
                return
            raise Deadlock(
                f"actors and learner have waited for each other for {lasting:.0f} s: the limiter lets none "
                f"go on after {self.limiter.inserts} inserts and {self.limiter.samples} samples "
                f"(surplus {self.limiter.surplus:g}, bound {self.limiter.error_bound:g})"
            )

    def waiting_text(self) -> str:
        """Who waits for whom, and for which share of the last minute; empty if nobody does. Within `held`."""
        return self.room.explain() or waiting_text(
            self.limiter,
            self.learner_waiting.share_of_the_minute(),
            self.actors_waiting.share_of_the_minute(),
        )

    @contextmanager
    def held(self) -> Iterator[None]:
        """Nothing is inserted or sampled inside the block: for a consistent snapshot."""
        with self._changed:
            yield

    def log_position(self) -> LogPosition:
        """End the log's segment and say where that is; only within `held`."""
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
        """Go on from `environment_steps`, after replay and limiter were restored."""
        with self._changed:
            self.environment_steps = environment_steps
            if self.complete:
                self.limiter.close()

    def remember(self, number: int) -> None:
        """A sequence of record `number` was put back into the replay, as its newest."""
        self._numbers.append(number)

    def take_again(self, sequences: list[Sequence], number: int) -> None:
        """Take in what record `number` of the log holds and no checkpoint does; it was accepted before."""
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
            self.room.missing(str(full))
            self.actors_waiting.begin()
            raise IntakeBusy(self.room.explain()) from None
        self.room.found()
        return number
