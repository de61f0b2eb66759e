"""Acknowledged upload: each chunk of an actor reaches the learner exactly once, over crashes of either.

Every chunk is held until the learner has acknowledged it. No answer means that the connection or the learner
has failed: all held chunks are sent again from the oldest on, ten times a second until there is an answer.
The number of held chunks is bounded (`upload_pace`), and when the bound is reached the actor waits.

Chunks are collected for a moment and sent together, several in a query (`bundle`), unless a caller waits for
them. The sending thread checks and encodes them one directly after the other: encoding them separately takes
six times as long, because the core's cache is cold.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from enum import Enum, auto
from typing import NamedTuple

import zenoh
from athrl_spaces.untrusted import one_line

from athrl_protocol.codec.chunks import OLDEST_HELD_BYTES, Identity, encode_checked, with_oldest_held
from athrl_protocol.codec.images import Compression
from athrl_protocol.delivery.bundle import MOST_BYTES, join_messages
from athrl_protocol.delivery.upload_pace import Pace
from athrl_protocol.delivery.upload_window import UploadStatistics, UploadWindow
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.faults.background import Background
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.chunk import Chunk, check_chunk
from athrl_protocol.messages.keys import Keys
from athrl_protocol.messages.schema import decode_message
from athrl_protocol.transport.closeable import Closeable
from athrl_protocol.transport.session import address_of, certificate_hint, undeclare_quietly

_log = logging.getLogger(__name__)

ANSWER_SECONDS = 5.0
IDLE_SECONDS = 1.0
SILENCE_PAUSE_SECONDS = 0.1
# Without an answer over an open connection until a warning; the first chunk may time out once.
SILENCE_WARNING_SECONDS = 10.0
# For which chunks are collected before they are sent together.
GATHER_SECONDS = 0.1
LONGEST_REASON = 1_000  # characters of a refusal that are logged


class _Outcome(Enum):
    """What an answer means for the chunks after it."""

    CONTINUE = auto()
    BUSY = auto()
    REWIND = auto()
    SILENCE = auto()


class _InFlight(NamedTuple):
    sequences: tuple[int, ...]  # of the chunks in the query
    replies: zenoh.handlers.Handler[zenoh.Reply]


class ChunkUploader(Closeable):
    """Sends an actor's chunks from a separate thread.

    Args:
        session: an open session, which stays the caller's.
        run: name of the run.
        actor: name of the actor.
        incarnation: of this process, from `new_incarnation`; a restarted actor needs a new one.
        capacity: most chunks that are held while the learner is away.
        compression: of the chunks' images.
    """

    def __init__(
        self,
        session: zenoh.Session,
        run: str,
        actor: str,
        incarnation: int,
        capacity: int,
        compression: Compression = "lz4",
    ) -> None:
        self._session = session
        self._actor = actor
        self._incarnation = incarnation
        self._window = UploadWindow()
        self._changed = threading.Condition()
        self._background = Background("the upload", _log, wake=self._wake)
        self._compression: Compression = compression
        self._raw: deque[tuple[int, Chunk]] = deque()  # not encoded yet, by sequence
        self._waiting = 0  # calls that wait for room, or for all chunks to be settled
        self._due_at = math.inf  # when unsent chunks have waited long enough
        self._in_flight: deque[_InFlight] = deque()  # used only by the thread
        self._pace = Pace(capacity)
        self._silent_since: float | None = None  # over an open connection
        self._finished = False
        self._closed = threading.Event()
        self._cancel = zenoh.CancellationToken()
        self._querier = session.declare_querier(
            Keys(run).experience(actor),
            timeout=ANSWER_SECONDS,
            congestion_control=zenoh.CongestionControl.BLOCK,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
        self._thread = threading.Thread(target=self._send_until_closed, name="upload", daemon=True)
        self._thread.start()

    @property
    def finished(self) -> bool:
        """Whether the learner said that the run is over; nothing is sent any more."""
        return self._finished

    def submit(self, chunk: Chunk, timeout: float) -> bool:
        """Submit a chunk; its actor, incarnation and sequence are set here.

        Waits at most `timeout` seconds while the bound is reached. An invalid chunk is given up and counted.

        Returns:
            Whether the chunk was taken; False after the timeout, when the run is over, or when closed.

        Raises:
            BackgroundFailed: the sending thread has failed; no more chunks will be sent.
        """
        with self._changed:
            self._wait_for(lambda: not self._is_full or self._is_over(), timeout)
            self._background.check()
            if self._is_full or self._is_over():
                return False
            self._raw.append((self._window.reserve(), chunk))
            # The thread is only woken when it has work, not by every chunk.
            if self._due_at == math.inf:
                self._due_at = time.monotonic() + GATHER_SECONDS
                self._changed.notify_all()
            elif self._is_due():
                self._changed.notify_all()
            return True

    def give_up(self, chunks: int) -> None:
        """Count chunks that will not be submitted, because the bound was reached."""
        with self._changed:
            self._window.leave_out(chunks)

    def flush(self, timeout: float) -> bool:
        """Wait at most `timeout` seconds until every chunk is settled; return whether all are.

        Raises:
            BackgroundFailed: the sending thread has failed.
        """
        with self._changed:
            self._wait_for(lambda: self._window.is_empty or self._is_over(), timeout)
            self._background.check()
            return self._window.is_empty and not self._closed.is_set()

    def statistics(self) -> UploadStatistics:
        """Return the counts of chunks."""
        with self._changed:
            return self._window.statistics()

    def close(self) -> None:
        """Stop at once and give up all held chunks; `flush` before to deliver them."""
        self._closed.set()
        self._cancel.cancel()
        with self._changed:
            self._changed.notify_all()
        self._thread.join(timeout=ANSWER_SECONDS)
        undeclare_quietly(self._querier)
        with self._changed:
            self._raw.clear()
            self._window.give_up_all("closed")
            self._changed.notify_all()

    @property
    def _is_full(self) -> bool:
        return len(self._window) >= self._pace.max_held

    def _is_over(self) -> bool:
        return self._finished or self._closed.is_set() or self._background.failed

    def _wait_for(self, condition: Callable[[], bool], timeout: float) -> None:
        """Wait at most `timeout` seconds for a condition that sending changes; within `_changed`."""
        if condition():
            return
        self._waiting += 1
        self._changed.notify_all()
        try:
            self._changed.wait_for(condition, timeout)
        finally:
            self._waiting -= 1

    def _is_due(self) -> bool:
        """Whether to send the unsent chunks now, or to collect more of them; within `_changed`."""
        if not self._window.has_unsent:
            return False
        if self._pace.probing or self._waiting or self._window.has_to_resend:
            return True
        return self._window.unsent >= self._pace.max_per_query or time.monotonic() >= self._due_at

    def _wake(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _send_until_closed(self) -> None:
        with self._background.watched():
            while not self._closed.is_set():
                try:
                    self._send_allowed()
                    if self._in_flight:
                        self._settle(self._in_flight.popleft())
                    elif self._wait_for_chunk():
                        self._resend(_Outcome.SILENCE)
                except zenoh.ZError as error:  # the session was closed, or the network refuses
                    _log.debug("upload: %s", error)
                    self._resend(_Outcome.SILENCE)

    def _wait_for_chunk(self) -> bool:
        """Wait for a chunk to send; return whether chunks are held although all were sent and answered."""
        with self._changed:
            # Chunks that were given up are no longer due; `_due_at` is set again with the next chunk.
            due_in = self._due_at - time.monotonic() if self._window.has_unsent else IDLE_SECONDS
            if due_in > 0.0 and not self._is_due() and not self._closed.is_set():
                self._changed.wait(min(IDLE_SECONDS, due_in))
            return not self._window.is_empty and not self._window.has_unsent

    def _send_allowed(self) -> None:
        while True:
            in_flight = sum(len(query.sequences) for query in self._in_flight)
            free = self._pace.max_in_flight - in_flight
            with self._changed:
                if free < 1 or not self._is_due():
                    return
            self._encode_submitted()
            sequences, messages = self._take_from_window(min(free, self._pace.max_per_query))
            if not messages:
                return
            content, attachment = join_messages(messages)
            replies = self._querier.get(
                payload=content, attachment=attachment, cancellation_token=self._cancel
            )
            self._in_flight.append(_InFlight(tuple(sequences), replies))

    def _encode_submitted(self) -> None:
        """Encode submitted chunks, outside of the lock that `submit` needs."""
        while True:
            with self._changed:
                if not self._raw:
                    return
                sequence, chunk = self._raw.popleft()
            encoded = self._encoded(sequence, chunk)
            with self._changed:
                if encoded is None:
                    self._window.give_up(sequence)
                else:
                    self._window.put(sequence, encoded)

    def _encoded(self, sequence: int, chunk: Chunk) -> bytes | None:
        """Check and encode a chunk; None if it is not valid."""
        try:
            check_chunk(chunk)
        except InvalidMessage as error:
            _log.warning("chunk %d is given up: %s", sequence, error)
            return None
        identity = Identity(self._actor, self._incarnation, sequence)
        return encode_checked(chunk, identity, self._compression)

    def _take_from_window(self, most: int) -> tuple[list[int], list[bytes]]:
        """Take up to `most` chunks from the window for one query: their sequences and messages."""
        sequences: list[int] = []
        messages: list[bytes] = []
        size = 0
        with self._changed:
            while len(messages) < most:
                taken = self._window.take(MOST_BYTES - size if messages else None)
                if taken is None:
                    break
                sequence, oldest_held, encoded = taken
                sequences.append(sequence)
                messages.append(with_oldest_held(encoded, oldest_held))
                size += len(encoded) + OLDEST_HELD_BYTES
            if not self._window.has_unsent:
                self._due_at = math.inf
        return sequences, messages

    def _settle(self, oldest: _InFlight) -> None:
        """Wait for the answer to the oldest query and act on it."""
        outcome = self._outcome_of(oldest)
        self._warn_about_silence(outcome)
        if outcome is not _Outcome.CONTINUE:
            # Later chunks cannot have been stored before this one; their answers only confirm that.
            while self._in_flight:
                self._outcome_of(self._in_flight.popleft())
            self._resend(outcome)
            return
        with self._changed:
            self._pace.answered()
            self._changed.notify_all()

    def _warn_about_silence(self, outcome: _Outcome) -> None:
        """Warn once if a connected learner does not answer: Zenoh drops forbidden messages silently."""
        if outcome is not _Outcome.SILENCE or not self._session.info.links():
            self._silent_since = None
            return
        now = time.monotonic()
        if self._silent_since is None:
            self._silent_since = now
        elif now - self._silent_since >= SILENCE_WARNING_SECONDS:
            self._silent_since = math.inf
            _log.warning(
                "connected to %s, where no learner takes chunks of %s: see the learner's log; or it is a "
                "router whose learner is away%s",
                address_of(self._session),
                self._actor,
                certificate_hint(self._session),
            )

    def _resend(self, outcome: _Outcome) -> None:
        """Send held chunks again, after a pause."""
        self._in_flight.clear()
        with self._changed:
            pause = self._pause_after(outcome)
            if outcome is not _Outcome.REWIND:
                self._window.rewind(turned_away=outcome is _Outcome.BUSY)
            self._changed.notify_all()
        self._closed.wait(pause)

    def _pause_after(self, outcome: _Outcome) -> float:
        """Adjust the pace to the outcome; return seconds to wait."""
        if outcome is _Outcome.BUSY:
            return self._pace.busy()
        if outcome is _Outcome.SILENCE:
            self._pace.silent()
            return SILENCE_PAUSE_SECONDS
        self._pace.rewound()
        return 0.0

    def _outcome_of(self, query: _InFlight) -> _Outcome:
        """Read the answer to a query, which arrives or fails within ANSWER_SECONDS."""
        outcome = _Outcome.SILENCE
        for reply in query.replies:
            try:
                if reply.ok is not None:
                    outcome = self._acknowledged(reply.ok.payload.to_bytes())
                elif reply.err is not None:
                    outcome = self._refused(query.sequences, reply.err.payload.to_bytes())
            except InvalidMessage as error:  # Zenoh's own time-out, or a learner of another release
                _log.debug("upload: %s", error)
        return outcome

    def _acknowledged(self, payload: bytes) -> _Outcome:
        message = decode_message(athrl_pb2.Acknowledgement, payload)
        with self._changed:
            self._pace.acknowledged(self._window.acknowledge(message.next_sequence), message.credits)
            self._changed.notify_all()
        return _Outcome.CONTINUE

    def _refused(self, sequences: tuple[int, ...], payload: bytes) -> _Outcome:
        """Act on the refusal of one chunk of a query; those before it in the query are settled."""
        message = decode_message(athrl_pb2.Refusal, payload)
        if message.index >= len(sequences):
            raise InvalidMessage("value", f"refusal: of chunk {message.index} of {len(sequences)}")
        sequence = sequences[message.index]
        with self._changed:
            if message.index:
                self._window.acknowledge(sequence)
            self._changed.notify_all()
            if message.reason == athrl_pb2.Refusal.BUSY:
                return _Outcome.BUSY
            if message.reason == athrl_pb2.Refusal.EXPECTED:
                self._window.rewind_to(message.expected_sequence)
                return _Outcome.REWIND
            if message.reason == athrl_pb2.Refusal.INVALID:
                reason = one_line(message.text[:LONGEST_REASON])
                _log.warning("the learner refused chunk %d: %s", sequence, reason)
                self._window.give_up(sequence)
                if sequence == sequences[-1]:
                    return _Outcome.CONTINUE
                self._window.rewind_to(sequence + 1)  # the later ones were not processed
                return _Outcome.REWIND
            if message.reason == athrl_pb2.Refusal.FINISHED:
                self._finished = True
                self._raw.clear()
                self._window.give_up_all("finished")
                return _Outcome.CONTINUE
        return _Outcome.SILENCE
