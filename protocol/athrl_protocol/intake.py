"""Intake: the learner's end of the acknowledged upload.

A chunk is acknowledged only after `accept` has returned, and is handed to `accept` once, however often it
arrives. `accept` runs in the intake's thread. It may wait a little for room (less than 0.1 s, because other
actors' chunks queue behind it) and then raise IntakeBusy, whereupon the actor sends the chunk again.
"""

from __future__ import annotations

import contextlib
import copy
import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import zenoh

from athrl_protocol import athrl_pb2
from athrl_protocol.chunk import Chunk
from athrl_protocol.chunk_codec import decode_chunk
from athrl_protocol.closing import Closing
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.keys import Keys
from athrl_protocol.ledger import Gap, Known, Ledger
from athrl_protocol.schema import encode_message
from athrl_protocol.session import undeclare_quietly

_log = logging.getLogger(__name__)

# Queries that may wait. A full queue would stop everything else on the link, so the credits of all
# actors together stay below it.
QUEUE_CAPACITY = 256
CREDITS = 8
ACTIVE_SECONDS = 10.0
CLOSE_SECONDS = 5.0


class IntakeBusy(Exception):  # noqa: N818 - says what is so, not what went wrong
    """Raised by `accept`: there is no room now, the actor shall send the chunk again."""


class IntakeFinished(Exception):  # noqa: N818
    """Raised by `accept`: the run has all the chunks it needs."""


@dataclass
class IntakeStatistics:
    """Counts since the intake was opened.

    Attributes:
        chunks: taken in.
        transitions: valid steps in them.
        duplicates: arrived again and were acknowledged again.
        gaps: arrived before an earlier one.
        lost: never taken in here and not held by their actor any more; most were acknowledged by a learner
            that died before it saved them.
        busy: sent back for lack of room.
        invalid: refused for good, by reason.
        active_actors: actors that were heard in the last ten seconds.
    """

    chunks: int = 0
    transitions: int = 0
    duplicates: int = 0
    gaps: int = 0
    lost: int = 0
    busy: int = 0
    invalid: dict[str, int] = field(default_factory=dict)
    active_actors: int = 0


class ChunkIntake(Closing):
    """Takes in the chunks of all actors.

    Args:
        session: the learner's session, which stays the caller's.
        run: name of the run.
        accept: called with each new chunk, one at a time. May raise IntakeBusy, IntakeFinished, or
            InvalidMessage for a chunk that does not fit the run. Any other exception is kept in
            `failure`, and nothing is taken in from then on.
        ledger: what `ledger()` returned when the checkpoint was made.
    """

    def __init__(
        self,
        session: zenoh.Session,
        run: str,
        accept: Callable[[Chunk], None],
        ledger: dict[str, Any] | None = None,
    ) -> None:
        self._accept = accept
        self._ledger = Ledger(ledger)
        self._statistics = IntakeStatistics()
        self._heard: dict[str, float] = {}
        self._lock = threading.RLock()
        self._stopped: athrl_pb2.Refusal.Reason | None = None
        self.failure: Exception | None = None
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

    def statistics(self) -> IntakeStatistics:
        """Return the counts."""
        with self._lock:
            statistics = copy.deepcopy(self._statistics)
            statistics.active_actors = self._active_actors()
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
        while True:
            try:
                query = queries.recv()
            except zenoh.ZError:  # closed
                return
            with query:
                try:
                    self._answer(query)
                except zenoh.ZError as error:  # who asked is gone, and will ask again
                    _log.debug("intake: %s", error)

    def _answer(self, query: zenoh.Query) -> None:
        try:
            chunk = decode_chunk(query.payload.to_bytes() if query.payload is not None else b"")
            if str(query.key_expr).rpartition("/")[2] != chunk.actor:
                raise InvalidMessage("value", f"chunk: of actor {chunk.actor!r} under {query.key_expr}")
            with self._lock:
                answer = self._take_in(chunk)
        except InvalidMessage as error:
            answer = self._invalid(error)
        except IntakeBusy:
            answer = self._busy()
        except IntakeFinished:
            answer = athrl_pb2.Refusal(reason=athrl_pb2.Refusal.FINISHED)
        except Exception as error:  # the learner's own mistake: its main thread has to know
            _log.exception("a chunk was not taken in")
            self.failure = error
            self.stop_accepting(finished=False)
            answer = self._busy()
        if isinstance(answer, athrl_pb2.Acknowledgement):
            query.reply(query.key_expr, encode_message(answer))
        else:
            query.reply_err(encode_message(answer))

    def _take_in(self, chunk: Chunk) -> athrl_pb2.Acknowledgement | athrl_pb2.Refusal:
        """Accept a chunk if it is new, and return the answer."""
        self._heard[chunk.actor] = time.monotonic()
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
            self._accept(chunk)
        except InvalidMessage:
            self._ledger.record(chunk)  # it is settled: the actor drops it and goes on with the next
            raise
        self._statistics.lost += verdict.lost
        self._statistics.chunks += 1
        self._statistics.transitions += chunk.length
        return self._acknowledgement(self._ledger.record(chunk))

    def _acknowledgement(self, next_sequence: int) -> athrl_pb2.Acknowledgement:
        share = QUEUE_CAPACITY // max(1, self._active_actors())
        return athrl_pb2.Acknowledgement(next_sequence=next_sequence, credits=max(1, min(CREDITS, share)))

    def _active_actors(self) -> int:
        now = time.monotonic()
        self._heard = {actor: heard for actor, heard in self._heard.items() if now - heard < ACTIVE_SECONDS}
        return len(self._heard)

    def _busy(self) -> athrl_pb2.Refusal:
        with self._lock:
            self._statistics.busy += 1
        return athrl_pb2.Refusal(reason=athrl_pb2.Refusal.BUSY)

    def _invalid(self, error: InvalidMessage) -> athrl_pb2.Refusal:
        with self._lock:
            invalid = self._statistics.invalid
            invalid[error.reason] = invalid.get(error.reason, 0) + 1
        _log.warning("a chunk was refused: %s", error)
        return athrl_pb2.Refusal(reason=athrl_pb2.Refusal.INVALID, text=str(error))
