"""Intake: the learner's end of the acknowledged upload.

A chunk is acknowledged only after `accept` has returned, and is handed to `accept` once, however often it
arrives. `accept` runs in the intake's thread. It may wait a little for room (less than 0.1 s, because other
actors' chunks queue behind it) and then raise IntakeBusy, whereupon the actor sends the chunk again.

A chunk is answered when `Receiver.commit` has returned. Where that takes time, because a disk is waited for,
what waits in the queue is taken in for as long as the last commit took and answered together: a fast disk
makes for quick answers, a slow one is asked once for many chunks.
"""

from __future__ import annotations

import contextlib
import copy
import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import zenoh

from athrl_protocol import athrl_pb2
from athrl_protocol.chunk import Chunk
from athrl_protocol.chunk_codec import MAXIMUM_MESSAGE_BYTES, decode_chunk
from athrl_protocol.closing import Closing
from athrl_protocol.credits import QUEUE_CAPACITY, Credits
from athrl_protocol.delivery import MOST_BYTES, taken_apart
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.keys import Keys
from athrl_protocol.ledger import Gap, Known, Ledger
from athrl_protocol.receiver import IntakeBusy, IntakeFinished, PlainReceiver, Receiver
from athrl_protocol.refusals import Refusals
from athrl_protocol.schema import encode_message
from athrl_protocol.session import undeclare_quietly

_log = logging.getLogger(__name__)

# Queries that are answered together; more would let the first of them wait for long.
BATCH = 32
CLOSE_SECONDS = 5.0


class _Answer(NamedTuple):
    """An answer that waits for the end of its batch."""

    query: zenoh.Query
    message: athrl_pb2.Acknowledgement | athrl_pb2.Refusal


@dataclass
class IntakeStatistics:
    """Counts of chunks, since the intake was opened unless it says "of the run".

    Of the run, `stored` + `refused` + `lost` are all chunks that are settled, each counted once whatever
    died in between; what arrives is `chunks` + `duplicates` + `gaps` + `busy` + the sum of `invalid`.

    Attributes:
        chunks: taken in.
        transitions: valid steps in them.
        duplicates: arrived again and were acknowledged again.
        gaps: arrived before an earlier one.
        busy: sent back for lack of room.
        invalid: refused for good, by reason.
        invalid_by_sender: the same for each sender, by the name that it gives itself.
        stored: of the run: taken in.
        refused: of the run: did not fit it.
        lost: of the run: never taken in here and not held by their actor any more; they were acknowledged
            by a learner whose disk failed, or could not be read at all.
        active_actors: actors that were heard in the last ten seconds.
    """

    chunks: int = 0
    transitions: int = 0
    duplicates: int = 0
    gaps: int = 0
    stored: int = 0
    refused: int = 0
    lost: int = 0
    busy: int = 0
    invalid: dict[str, int] = field(default_factory=dict)
    invalid_by_sender: dict[str, dict[str, int]] = field(default_factory=dict)
    active_actors: int = 0


class ChunkIntake(Closing):
    """Takes in the chunks of all actors.

    Args:
        session: the learner's session, which stays the caller's.
        run: name of the run.
        accept: called with each new chunk, one at a time; a receiver also writes it down. May raise
            IntakeBusy, IntakeFinished, or InvalidMessage for a chunk that does not fit the run. Any other
            exception is kept in `failure`, and nothing is taken in from then on.
        ledger: to go on with; what `ledger()` returned when the checkpoint was made, or a ledger.
        largest: bytes of a message beyond which it can be no chunk of this run.
    """

    def __init__(
        self,
        session: zenoh.Session,
        run: str,
        accept: Callable[[Chunk], None] | Receiver,
        ledger: dict[str, Any] | Ledger | None = None,
        largest: int = MAXIMUM_MESSAGE_BYTES,
    ) -> None:
        self._largest = largest
        self._refusals = Refusals("a chunk", _log)
        self._receiver = accept if isinstance(accept, Receiver) else PlainReceiver(accept)
        self._ledger = ledger if isinstance(ledger, Ledger) else Ledger(ledger)
        self._statistics = IntakeStatistics()
        self._credits = Credits()
        self._commit_seconds = 0.0  # how long the last commit took
        self._lock = threading.RLock()
        self._stopped: athrl_pb2.Refusal.Reason | None = None
        self.failure: BaseException | None = None
        self._queryable = session.declare_queryable(
            Keys(run).every_experience, zenoh.handlers.FifoChannel(QUEUE_CAPACITY), complete=True
        )
        # By its handler: Queryable.recv would keep `close` from undeclaring it.
        self._thread = threading.Thread(
            target=self._serve, args=(self._queryable.handler,), name="intake", daemon=True
        )
        self._thread.start()

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """Hold the intake still, so that the ledger and the replay it describes are saved together."""
        with self._lock:
            yield

    def ledger(self) -> dict[str, dict[str, int]]:
        """Return what was taken in, as plain JSON values for a checkpoint."""
        with self._lock:
            return self._ledger.to_json()

    def totals(self) -> dict[str, int]:
        """Return the run's totals (see `Totals`), which go with the ledger."""
        with self._lock:
            return self._ledger.totals_to_json()

    def statistics(self) -> IntakeStatistics:
        """Return the counts."""
        with self._lock:
            statistics = copy.deepcopy(self._statistics)
            statistics.active_actors = self._credits.active_actors()
            statistics.invalid = self._refusals.by_reason()
            statistics.invalid_by_sender = self._refusals.by_sender()
            totals = self._ledger.totals
            statistics.stored, statistics.refused, statistics.lost = (
                totals.stored,
                totals.refused,
                totals.lost,
            )
            return statistics

    def stop_accepting(self, *, finished: bool = False) -> None:
        """Take nothing in from now on; when this returns, no `accept` is running.

        Args:
            finished: tell actors that the run is over; else that they shall keep their chunks for the
                learner that resumes the run.
        """
        with self._lock:
            self._stopped = athrl_pb2.Refusal.FINISHED if finished else athrl_pb2.Refusal.BUSY

    def close(self) -> None:
        """Stop listening; what was not acknowledged stays with its actor."""
        undeclare_quietly(self._queryable)
        self._thread.join(timeout=CLOSE_SECONDS)

    def _serve(self, queries: zenoh.handlers.Handler[zenoh.Query]) -> None:
        try:
            self._serve_until_closed(queries)
        except BaseException as error:  # a panic inside of Zenoh is no Exception
            self._fail(error)

    def _serve_until_closed(self, queries: zenoh.handlers.Handler[zenoh.Query]) -> None:
        while True:
            try:
                query: zenoh.Query | None = queries.recv()
            except zenoh.ZError:  # closed
                return
            until = time.monotonic() + self._commit_seconds
            answers = []
            while query is not None:
                answers.append(_Answer(query, self._judge(query)))
                full = len(answers) >= BATCH or time.monotonic() >= until
                query = None if full else _next_of(queries)
            self._answer(answers)

    def _answer(self, answers: list[_Answer]) -> None:
        """Send the answers once all that they promise is safe; promise nothing if it is not."""
        began = time.monotonic()
        try:
            self._receiver.commit()
        except Exception as error:
            self._fail(error)
            answers = [_Answer(query, self._busy()) for query, _ in answers]
        self._commit_seconds = time.monotonic() - began
        for query, message in answers:
            with query:
                try:
                    if isinstance(message, athrl_pb2.Acknowledgement):
                        query.reply(query.key_expr, encode_message(message))
                    else:
                        query.reply_err(encode_message(message))
                except zenoh.ZError as error:  # who asked is gone, and will ask again
                    _log.debug("intake: %s", error)

    def _judge(self, query: zenoh.Query) -> athrl_pb2.Acknowledgement | athrl_pb2.Refusal:
        """Take in what the query brings, and return the answer: to the first chunk that was not taken in."""
        sender = str(query.key_expr).rpartition("/")[2]
        try:
            messages = self._messages(query)
        except InvalidMessage as error:
            return self._refused(sender, error)
        answer: athrl_pb2.Acknowledgement | athrl_pb2.Refusal | None = None
        for index, message in enumerate(messages):
            answer = self._judge_chunk(sender, message)
            if isinstance(answer, athrl_pb2.Refusal):
                answer.index = index
                break
        assert answer is not None
        return answer

    def _judge_chunk(self, sender: str, message: bytes) -> athrl_pb2.Acknowledgement | athrl_pb2.Refusal:
        """Take a chunk in, and return the answer to it."""
        try:
            if len(message) > self._largest:
                raise InvalidMessage(
                    "size", f"chunk: {len(message)} bytes, at most {self._largest} in this run"
                )
            chunk = decode_chunk(message)
            if sender != chunk.actor:
                raise InvalidMessage("value", f"chunk: of actor {chunk.actor!r} under the key of another")
            with self._lock:
                return self._take_in(chunk, message)
        except InvalidMessage as error:
            return self._refused(sender, error)
        except IntakeBusy:
            return self._busy()
        except IntakeFinished:
            return athrl_pb2.Refusal(reason=athrl_pb2.Refusal.FINISHED)
        except Exception as error:
            self._fail(error)
            return self._busy()

    def _refused(self, sender: str, error: InvalidMessage) -> athrl_pb2.Refusal:
        self._refusals.add(sender, error)
        return athrl_pb2.Refusal(reason=athrl_pb2.Refusal.INVALID, text=str(error))

    def _messages(self, query: zenoh.Query) -> list[bytes]:
        """Return what a query brings, if it is small enough to be looked at; else raise InvalidMessage."""
        size = len(query.payload) if query.payload is not None else 0
        largest = self._largest if query.attachment is None else max(self._largest, MOST_BYTES)
        if size > largest:
            raise InvalidMessage("size", f"chunk: {size} bytes, at most {largest} in this run")
        content = query.payload.to_bytes() if query.payload is not None else b""
        return taken_apart(content, None if query.attachment is None else query.attachment.to_bytes())

    def _fail(self, error: BaseException) -> None:
        """Take nothing in any more after the learner's own mistake; its main thread has to know."""
        _log.error("a chunk was not taken in: %s", error, exc_info=error)
        self.failure = error
        self.stop_accepting(finished=False)

    def _take_in(self, chunk: Chunk, message: bytes) -> athrl_pb2.Acknowledgement | athrl_pb2.Refusal:
        """Accept a chunk if it is new, and return the answer."""
        if self.failure is not None:
            raise IntakeBusy  # the ledger knows chunks that are not safe: not even "known" may be said
        self._credits.hear(chunk.actor)
        verdict = self._ledger.judge(chunk)
        if isinstance(verdict, Known):
            self._statistics.duplicates += 1
            return self._acknowledgement(verdict.next_sequence)
        if self._stopped == athrl_pb2.Refusal.FINISHED:
            raise IntakeFinished
        if self._stopped is not None:
            raise IntakeBusy
        if isinstance(verdict, Gap):
            self._statistics.gaps += 1
            return athrl_pb2.Refusal(
                reason=athrl_pb2.Refusal.EXPECTED, expected_sequence=verdict.expected_sequence
            )
        try:
            self._receiver.accept(chunk, message)
        except InvalidMessage:
            self._receiver.refuse(chunk)  # it is settled: the actor drops it and goes on with the next
            self._ledger.refuse(chunk.actor, chunk.incarnation, chunk.sequence)
            raise
        self._statistics.chunks += 1
        self._statistics.transitions += chunk.length
        return self._acknowledgement(self._ledger.record(chunk))

    def _acknowledgement(self, next_sequence: int) -> athrl_pb2.Acknowledgement:
        return athrl_pb2.Acknowledgement(next_sequence=next_sequence, credits=self._credits.of_each())

    def _busy(self) -> athrl_pb2.Refusal:
        with self._lock:
            self._statistics.busy += 1
        return athrl_pb2.Refusal(reason=athrl_pb2.Refusal.BUSY)


def _next_of(queries: zenoh.handlers.Handler[zenoh.Query]) -> zenoh.Query | None:
    """Return a query that waits, None if there is none or the queue is closed."""
    with contextlib.suppress(zenoh.ZError):
        return queries.try_recv()
    return None
