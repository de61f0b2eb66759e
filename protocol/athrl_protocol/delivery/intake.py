"""Intake: the learner's side of the acknowledged upload.

A chunk is acknowledged only after `accept` has returned, and is passed to `accept` once, however often it
arrives. `accept` runs in the intake's thread. It may wait shortly for room (less than 0.1 s, because chunks
of other actors wait behind it) and then raise IntakeBusy; the actor then sends the chunk again.

A chunk is answered when `Receiver.commit` has returned. If a commit takes time, because of a slow disk, more
waiting chunks are taken in for as long as the last commit took, and are answered together: with a fast disk
answers are quick, with a slow one there is one commit for many chunks.
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

from athrl_protocol.codec.chunks import MAXIMUM_MESSAGE_BYTES, decode_chunk
from athrl_protocol.delivery.bundle import MOST_BYTES, split_messages
from athrl_protocol.delivery.credits import QUEUE_CAPACITY, Credits
from athrl_protocol.delivery.ledger import Gap, Known, Ledger, New
from athrl_protocol.delivery.receiver import IntakeBusy, IntakeFinished, PlainReceiver, Receiver
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.faults.bounded_log import BoundedLog
from athrl_protocol.faults.refusals import Refusals
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.chunk import Chunk
from athrl_protocol.messages.keys import Keys
from athrl_protocol.messages.schema import encode_message
from athrl_protocol.transport.closeable import Closeable
from athrl_protocol.transport.session import undeclare_quietly

_log = logging.getLogger(__name__)

# Most queries that are answered together; with more the first of them would wait too long.
BATCH = 32
CLOSE_SECONDS = 5.0


class _Answer(NamedTuple):
    """An answer that is sent at the end of its batch."""

    query: zenoh.Query
    message: athrl_pb2.Acknowledgement | athrl_pb2.Refusal


@dataclass
class IntakeStatistics:
    """Counts of chunks, since the intake was opened or, where it says so, of the run.

    Of the run, `stored` + `refused` + `lost` are all settled chunks, each counted once over all restarts; all
    arrivals are `chunks` + `duplicates` + `gaps` + `busy` + the sum of `invalid`.

    Attributes:
        chunks: taken in.
        transitions: valid steps in them.
        duplicates: arrived again and were acknowledged again.
        gaps: arrived before an earlier chunk.
        busy: sent back because there was no room.
        invalid: refused permanently, by reason.
        invalid_by_sender: the same for each sender, by the name in its key.
        stored: of the run: taken in.
        refused: of the run: did not fit the run.
        lost: of the run: never taken in here and no longer held by their actor; they were acknowledged by a
            learner whose disk failed, or could not be read, or by another process.
        active_actors: actors that sent a message in the last ten seconds.
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


class ChunkIntake(Closeable):
    """Takes in the chunks of all actors.

    Args:
        session: the learner's session, which stays the caller's.
        run: name of the run.
        accept: called with each new chunk, one at a time; a receiver also logs it. May raise
            IntakeBusy, IntakeFinished, or InvalidMessage for a chunk that does not fit the run. Any other
            exception is kept in `failure`, and then no more chunks are taken in.
        ledger: the ledger to continue with, or what `ledger()` returned at the time of the checkpoint.
        largest: most bytes of a chunk's message in this run.
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
        self._warn = BoundedLog(_log.warning)
        self._receiver = accept if isinstance(accept, Receiver) else PlainReceiver(accept)
        self._ledger = ledger if isinstance(ledger, Ledger) else Ledger(ledger)
        self._statistics = IntakeStatistics()
        self._credits = Credits()
        self._commit_seconds = 0.0  # duration of the last commit
        self._lock = threading.RLock()
        self._stopped: athrl_pb2.Refusal.Reason | None = None
        self.failure: BaseException | None = None
        self._queryable = session.declare_queryable(
            Keys(run).every_experience, zenoh.handlers.FifoChannel(QUEUE_CAPACITY), complete=True
        )
        # By its handler: Queryable.recv would prevent `close` from undeclaring it.
        self._thread = threading.Thread(
            target=self._serve, args=(self._queryable.handler,), name="intake", daemon=True
        )
        self._thread.start()

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """Pause the intake, so that the ledger and the replay that it describes are saved together."""
        with self._lock:
            yield

    def ledger(self) -> dict[str, dict[str, int]]:
        """Return the ledger as plain JSON values for a checkpoint."""
        with self._lock:
            return self._ledger.to_json()

    def totals(self) -> dict[str, int]:
        """Return the run's totals (see `Totals`), which belong to the ledger."""
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
        """Accept no more chunks; when this returns, no `accept` is running.

        Args:
            finished: tell actors that the run is over; otherwise they keep their chunks for the learner that
                resumes the run.
        """
        with self._lock:
            self._stopped = athrl_pb2.Refusal.FINISHED if finished else athrl_pb2.Refusal.BUSY

    def close(self) -> None:
        """Stop listening; actors keep chunks that were not acknowledged."""
        undeclare_quietly(self._queryable)
        self._thread.join(timeout=CLOSE_SECONDS)

    def _serve(self, queries: zenoh.handlers.Handler[zenoh.Query]) -> None:
        try:
            self._serve_until_closed(queries)
        except BaseException as error:  # a panic inside Zenoh is not an Exception
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
                answers.append(_Answer(query, self._handle(query)))
                full = len(answers) >= BATCH or time.monotonic() >= until
                query = None if full else _next_waiting(queries)
            self._answer(answers)

    def _answer(self, answers: list[_Answer]) -> None:
        """Commit, then send the answers; if the commit fails, acknowledge nothing."""
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
                except zenoh.ZError as error:  # the sender has disconnected and will send again
                    _log.debug("intake: %s", error)

    def _handle(self, query: zenoh.Query) -> athrl_pb2.Acknowledgement | athrl_pb2.Refusal:
        """Take in the chunks of a query; return the answer to the first refused one, or to the last."""
        sender = str(query.key_expr).rpartition("/")[2]
        try:
            messages = self._messages(query)
        except InvalidMessage as error:
            return self._refused(sender, error)
        answer: athrl_pb2.Acknowledgement | athrl_pb2.Refusal | None = None
        for index, message in enumerate(messages):
            answer = self._handle_chunk(sender, message)
            if isinstance(answer, athrl_pb2.Refusal):
                answer.index = index
                break
        assert answer is not None
        return answer

    def _handle_chunk(self, sender: str, message: bytes) -> athrl_pb2.Acknowledgement | athrl_pb2.Refusal:
        """Take a chunk in, and return the answer to it."""
        try:
            if len(message) > self._largest:
                raise InvalidMessage(
                    "size", f"chunk: {len(message)} bytes, at most {self._largest} in this run"
                )
            chunk = decode_chunk(message, self._largest)
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
        """Return the messages in a query; raise InvalidMessage if it is too large."""
        size = len(query.payload) if query.payload is not None else 0
        largest = self._largest if query.attachment is None else max(self._largest, MOST_BYTES)
        if size > largest:
            raise InvalidMessage("size", f"chunk: {size} bytes, at most {largest} in this run")
        content = query.payload.to_bytes() if query.payload is not None else b""
        return split_messages(content, None if query.attachment is None else query.attachment.to_bytes())

    def _fail(self, error: BaseException) -> None:
        """Accept no more chunks after an error of the learner itself, and keep it for the main thread."""
        _log.error("a chunk was not accepted: %s", error, exc_info=error)
        self.failure = error
        self.stop_accepting(finished=False)

    def _take_in(self, chunk: Chunk, message: bytes) -> athrl_pb2.Acknowledgement | athrl_pb2.Refusal:
        """Accept a chunk if it is new, and return the answer."""
        if self.failure is not None:
            raise IntakeBusy  # the ledger has chunks that are not safe: acknowledge none
        self._credits.note_message(chunk.actor)
        verdict = self._ledger.hear(chunk)
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
            self._receiver.refuse(chunk)  # it is settled: the actor drops it and continues with the next
            self._ledger.refuse(chunk.actor, chunk.incarnation, chunk.sequence)
            self._warn_of_loss(chunk, verdict)
            raise
        self._statistics.chunks += 1
        self._statistics.transitions += chunk.length
        following = self._ledger.record(chunk)
        self._warn_of_loss(chunk, verdict)
        return self._acknowledgement(following)

    def _warn_of_loss(self, chunk: Chunk, settled: New) -> None:
        if settled.lost:
            self._warn(
                f"chunks of {chunk.actor} are lost (intake/lost): it does not hold them any more, and they "
                "were not accepted here; another process may have acknowledged them"
            )

    def _acknowledgement(self, next_sequence: int) -> athrl_pb2.Acknowledgement:
        return athrl_pb2.Acknowledgement(next_sequence=next_sequence, credits=self._credits.per_actor())

    def _busy(self) -> athrl_pb2.Refusal:
        with self._lock:
            self._statistics.busy += 1
        return athrl_pb2.Refusal(reason=athrl_pb2.Refusal.BUSY)


def _next_waiting(queries: zenoh.handlers.Handler[zenoh.Query]) -> zenoh.Query | None:
    """Return a waiting query; None if there is none or the queue is closed."""
    with contextlib.suppress(zenoh.ZError):
        return queries.try_recv()
    return None
