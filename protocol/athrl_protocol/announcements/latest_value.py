"""The newest value of a kind: a put to all present subscribers, and a queryable for late ones.

A publisher has a liveliness token under its key. A subscriber that sees a token, because one of the two
started late, queries the newest value. Each value carries a version: the publisher's incarnation, which grows
with time, and the number of the value within it. A subscriber takes a value only if its version is newer than
the last one. So a delayed value never replaces a newer one, and the values of a publisher that was restarted
from an old checkpoint are taken at once although its own counters went back. If the clock of the new
publisher is behind that of the old one, its values are taken once the old one has left.

A put may be lost. Where a lost value must be replaced soon, the publisher repeats its newest version, and a
subscriber with an older one queries the value. A reminder never overtakes its value.
"""

from __future__ import annotations

import contextlib
import logging
import math
import queue
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

import zenoh

from athrl_protocol.errors import InvalidMessage
from athrl_protocol.faults.background import Background
from athrl_protocol.faults.refusals import OTHERS, Refusals
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.keys import check_incarnation, new_incarnation
from athrl_protocol.messages.schema import decode_message, encode_message
from athrl_protocol.transport.closeable import Closeable
from athrl_protocol.transport.session import undeclare_quietly

_log = logging.getLogger(__name__)

QUERY_SECONDS = 5.0
RETRY_SECONDS = 0.05
# Shortest time between two queries because of reminders, so that a slow value is not sent many times.
REMINDED_SECONDS = 1.0
# New publishers that wait for their query. Further ones are not asked: whoever makes up thousands that do not
# answer must not keep the session waiting, and what a publisher sends is taken in any case.
MOST_WAITING = 1024
# Keys whose newest version is known. Of a further one the version of another is forgotten, if possible of one
# whose publisher has left: whoever makes up keys must not take the memory of a service.
MOST_KEYS = 65_536
IDLE_SECONDS = 5.0  # after which the thread looks whether its session was closed


class Version(NamedTuple):
    """Orders values by age."""

    incarnation: int
    number: int


class LatestPublisher(Closeable):
    """Publishes values under a key and answers late subscribers with the newest.

    Args:
        session: an open session, which stays the caller's.
        key: key expression without wildcards.
        remind_seconds: seconds between reminders of the newest version; None: no reminders.
    """

    def __init__(self, session: zenoh.Session, key: str, remind_seconds: float | None = None) -> None:
        self._key = key
        self._closed = threading.Event()
        self._background = Background(f"reminding of {key}", _log)
        self._incarnation = new_incarnation()
        self._number = 0
        self._newest: tuple[bytes, bytes] | None = None
        self._lock = threading.Lock()
        self._publisher = session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.BLOCK, reliability=zenoh.Reliability.RELIABLE
        )
        self._queryable = session.declare_queryable(key, self._answer, complete=True)
        # A separate publisher, because a reminder is dropped if it would have to wait.
        self._reminders = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
        # Last, because a subscriber that sees the token queries it.
        self._token = session.liveliness().declare_token(key)
        self._reminder = threading.Thread(
            target=self._remind, args=(remind_seconds,), name="reminder", daemon=True
        )
        if remind_seconds is not None:
            self._reminder.start()

    def publish(self, payload: bytes) -> None:
        """Make `payload` the newest value and send it to all subscribers.

        Raises:
            BackgroundFailed: the thread for reminders has failed.
        """
        self._background.check()
        with self._lock:
            self._number += 1
            attachment = self._version(reminder=False)
            self._newest = (payload, attachment)
            self._publisher.put(payload, attachment=attachment)

    def supersede(self, incarnation: int) -> None:
        """Continue as a newer incarnation than another publisher's, and send the newest value again."""
        with self._lock:
            if incarnation < self._incarnation:
                return
            self._incarnation = incarnation + 1
            if self._newest is not None:
                payload, _ = self._newest
                attachment = self._version(reminder=False)
                self._newest = (payload, attachment)
                self._publisher.put(payload, attachment=attachment)

    def _version(self, *, reminder: bool) -> bytes:
        return encode_message(
            athrl_pb2.Version(incarnation=self._incarnation, number=self._number, reminder=reminder)
        )

    def _remind(self, seconds: float) -> None:
        with self._background.watched():
            while not self._closed.wait(seconds):
                with self._lock, contextlib.suppress(zenoh.ZError):  # the session may be closed already
                    if self._newest is not None:
                        self._reminders.put(b"", attachment=self._version(reminder=True))

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            newest = self._newest
            if newest is None:
                query.reply_del(self._key)  # distinguishes "no value yet" from "no publisher yet"
            else:
                payload, attachment = newest
                query.reply(self._key, payload, attachment=attachment)

    def close(self) -> None:
        """Stop answering and sending; the value ends with its publisher."""
        self._closed.set()
        # First: a publisher that is in use cannot be undeclared.
        if self._reminder.is_alive():
            self._reminder.join(timeout=QUERY_SECONDS)
        for declared in (self._token, self._queryable, self._publisher, self._reminders):
            undeclare_quietly(declared)


class LatestSubscriber(Closeable):
    """Takes the newest value of each matching key.

    Args:
        session: an open session, which stays the caller's.
        key: key expression; with wildcards every matching key has its own newest value.
        on_value: called with each new value, in order, from a thread of this object.
        on_failure: called after an error, to wake callers that wait for a value.

    Errors of `on_value` or of a thread of this object are logged, and raised as BackgroundFailed by `check`.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        on_value: Callable[[bytes], None],
        on_failure: Callable[[], None] = lambda: None,
    ) -> None:
        self._on_value = on_value
        self._refusals = Refusals(f"a value under {key}", _log)
        self._lock = threading.RLock()  # of the versions, and while a value is delivered
        self._background = Background(f"the subscription to {key}", _log, wake=on_failure)
        self._versions: dict[str, Version] = {}
        self._without_publisher: set[str] = set()
        self._asked_at = -math.inf  # last query because of a reminder
        self._closed = threading.Event()
        self._cancel = zenoh.CancellationToken()
        self._session = session
        self._key = key
        self._new_publishers: queue.Queue[str | None] = queue.Queue(MOST_WAITING)  # keys; None: closed
        self._subscriber = session.declare_subscriber(key, self._take)
        self._publishers = session.liveliness().declare_subscriber(key, self._note_publisher, history=True)
        self._asker = threading.Thread(target=self._query_new_publishers, name="newest", daemon=True)
        self._asker.start()

    def ask(self) -> None:
        """Query the newest values again and return at once; they are taken as if they had been sent.

        For a caller that knows of a newer value which did not arrive.
        """
        with contextlib.suppress(zenoh.ZError):  # the session is closed
            self._session.get(
                self._key,
                handler=self._take_reply,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=QUERY_SECONDS,
                cancellation_token=self._cancel,
            )

    def close(self) -> None:
        """Stop listening; no value is delivered afterwards."""
        self._closed.set()
        self._cancel.cancel()
        for declared in (self._publishers, self._subscriber):
            undeclare_quietly(declared)
        with contextlib.suppress(queue.Full):
            self._new_publishers.put_nowait(None)
        with self._lock:  # the last delivery ends
            pass
        if threading.current_thread() is not self._asker:
            self._asker.join(timeout=QUERY_SECONDS)

    @property
    def failed(self) -> bool:
        """Whether a thread of this object or `on_value` failed."""
        return self._background.failed

    def check(self) -> None:
        """Raise BackgroundFailed if a thread of this object or `on_value` failed."""
        self._background.check()

    def _take_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._take(reply.ok)

    def _take(self, sample: zenoh.Sample) -> None:
        """Keep a value if it is newer than that of its key; may be called by several threads."""
        with self._background.watched():
            self._keep(sample)

    def _keep(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.DELETE:  # the publisher has no value yet
            return
        try:
            version, is_reminder = version_of(sample)
        except InvalidMessage as error:
            self._refusals.add(OTHERS, error)
            return
        key = str(sample.key_expr)
        if is_reminder:
            self._request_missed(key, version)
            return
        payload = sample.payload.to_bytes()
        with self._lock:
            if self._closed.is_set() or not self._is_newer(key, version):
                return
            self._note_version(key, version)
            # Within the lock, so that two threads (put and reply) cannot deliver values in the wrong order.
            self._on_value(payload)

    def _note_version(self, key: str, version: Version) -> None:
        """Note the newest version of a key, whose publisher is there."""
        if key not in self._versions and len(self._versions) >= MOST_KEYS:
            forgotten = next(iter(self._without_publisher), next(iter(self._versions)))
            del self._versions[forgotten]
            self._without_publisher.discard(forgotten)
        self._versions[key] = version
        self._without_publisher.discard(key)

    def _request_missed(self, key: str, version: Version) -> None:
        """Query a value that was announced and did not arrive, unless it was queried just now."""
        now = time.monotonic()
        with self._lock:
            if not self._is_newer(key, version) or now - self._asked_at < REMINDED_SECONDS:
                return
            self._asked_at = now
        self.ask()

    def _is_newer(self, key: str, version: Version) -> bool:
        known = self._versions.get(key)
        if known is None or version > known:
            return True
        return key in self._without_publisher and version.incarnation != known.incarnation

    def _note_publisher(self, event: zenoh.Sample) -> None:
        """Note that a publisher has come or left; called in Zenoh's thread, which must not wait."""
        with self._background.watched():
            key = str(event.key_expr)
            if event.kind != zenoh.SampleKind.PUT:
                with self._lock:
                    if key in self._versions:
                        self._without_publisher.add(key)
                return
            with contextlib.suppress(queue.Full):
                self._new_publishers.put_nowait(key)

    def _query_new_publishers(self) -> None:
        """Query every new publisher for its newest value, until closed."""
        with self._background.watched():
            while not self._closed.is_set() and not self._session.is_closed():
                try:
                    key = self._new_publishers.get(timeout=IDLE_SECONDS)
                    if key is not None:
                        self._query(key)
                except queue.Empty:
                    continue
                except zenoh.ZError:
                    if not (self._closed.is_set() or self._session.is_closed()):
                        raise

    def _query(self, key: str) -> None:
        """Query the publisher of a key, and repeat that for some time if it does not answer."""
        deadline = time.monotonic() + QUERY_SECONDS
        while not self._closed.is_set():
            answered = False
            replies = self._session.get(
                key,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=QUERY_SECONDS,
                cancellation_token=self._cancel,
            )
            for reply in replies:
                answered = answered or reply.ok is not None
                self._take_reply(reply)
            if answered or time.monotonic() > deadline or self._closed.wait(RETRY_SECONDS):
                return


def version_of(sample: zenoh.Sample) -> tuple[Version, bool]:
    """Return the version of a sample, and whether it is a reminder instead of a value.

    Raises:
        InvalidMessage: it has none, or one from the future.
    """
    if sample.attachment is None:
        raise InvalidMessage("malformed", "a value without a version")
    message = decode_message(athrl_pb2.Version, sample.attachment.to_bytes())
    check_incarnation(f"version {message.number} of {sample.key_expr}", message.incarnation, time.time())
    return Version(message.incarnation, message.number), message.reminder
