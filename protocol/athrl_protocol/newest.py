"""The newest value of a kind: a put to everybody who is there, and a queryable for whoever comes late.

A publisher has a liveliness token under its key. A subscriber that sees one, because it came late or the
publisher did, asks for the newest value. Each value carries an edition: the publisher's incarnation, which
grows with time, and the number of the value within it. A subscriber takes a value only if its edition is
newer than what it has, so a delayed value never replaces a newer one, and a publisher that was started again
from an old checkpoint is heard at once although its own counters went back. Should the new publisher's clock
be behind the old one's, it is heard once the old one is seen to be gone.

A put may be lost. Where it matters how soon that is made up for, the publisher tells its newest edition again
and again, and a subscriber that has an older one asks. A reminder never overtakes the value that it is of.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

import zenoh

from athrl_protocol import athrl_pb2
from athrl_protocol.background import Background
from athrl_protocol.closing import Closing
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.keys import new_incarnation
from athrl_protocol.refusals import OTHERS, Refusals
from athrl_protocol.schema import decode_message, encode_message
from athrl_protocol.session import undeclare_quietly

_log = logging.getLogger(__name__)

QUERY_SECONDS = 5.0
RETRY_SECONDS = 0.05
# After a reminder a value is asked for; if it is on a slow way, it shall not come many times.
REMINDED_SECONDS = 1.0


class Edition(NamedTuple):
    """Says which of two values is newer."""

    incarnation: int
    number: int


class NewestPublisher(Closing):
    """Publishes values under a key and answers latecomers with the newest.

    Args:
        session: an open session, which stays the caller's.
        key: key expression without wildcards.
        remind_seconds: how often to tell the newest edition again; None: never.
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
        # Of its own, because a reminder is dropped where it would have to wait.
        self._reminders = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
        # Last, because whoever sees the token asks the queryable.
        self._token = session.liveliness().declare_token(key)
        self._reminder = threading.Thread(
            target=self._remind, args=(remind_seconds,), name="reminder", daemon=True
        )
        if remind_seconds is not None:
            self._reminder.start()

    def publish(self, payload: bytes) -> None:
        """Make `payload` the newest value and send it to all subscribers.

        Raises:
            BackgroundFailed: the thread that reminds of the values has failed.
        """
        self._background.check()
        with self._lock:
            self._number += 1
            attachment = self._edition(reminder=False)
            self._newest = (payload, attachment)
            self._publisher.put(payload, attachment=attachment)

    def _edition(self, *, reminder: bool) -> bytes:
        return encode_message(
            athrl_pb2.Edition(incarnation=self._incarnation, number=self._number, reminder=reminder)
        )

    def _remind(self, seconds: float) -> None:
        with self._background.watched():
            while not self._closed.wait(seconds):
                with self._lock, contextlib.suppress(zenoh.ZError):  # the session may be closed already
                    if self._newest is not None:
                        self._reminders.put(b"", attachment=self._edition(reminder=True))

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            newest = self._newest
            if newest is None:
                query.reply_del(self._key)  # tells "nothing yet" from "nobody there yet"
            else:
                payload, attachment = newest
                query.reply(self._key, payload, attachment=attachment)

    def close(self) -> None:
        """Stop answering and sending; the value is gone with its publisher."""
        self._closed.set()
        # First: what is just being put cannot be undeclared.
        if self._reminder.is_alive():
            self._reminder.join(timeout=QUERY_SECONDS)
        for declared in (self._token, self._queryable, self._publisher, self._reminders):
            undeclare_quietly(declared)


class NewestSubscriber(Closing):
    """Keeps the newest value of each key that matches.

    Args:
        session: an open session, which stays the caller's.
        key: key expression; with wildcards every matching key has a newest value of its own.
        on_value: called with each value that is taken, from a thread of this object, in order.

    What `on_value` or a thread of this object raises is logged, and raised as BackgroundFailed by `latest`
    and `wait`.
    """

    def __init__(
        self, session: zenoh.Session, key: str, on_value: Callable[[bytes], None] | None = None
    ) -> None:
        self._on_value = on_value
        self._refusals = Refusals(f"a value under {key}", _log)
        self._changed = threading.Condition()
        self._background = Background(f"the subscription to {key}", _log, wake=self._wake)
        self._editions: dict[str, Edition] = {}
        self._without_publisher: set[str] = set()
        self._asked_at = -math.inf  # because of a reminder
        self._latest: bytes | None = None
        self._closed = threading.Event()
        self._cancel = zenoh.CancellationToken()
        self._session = session
        self._key = key
        self._subscriber = session.declare_subscriber(key, self._take)
        self._publishers = session.liveliness().declare_subscriber(key, history=True)
        # By its handler: Subscriber.recv would keep `close` from undeclaring it.
        self._asker = threading.Thread(
            target=self._ask_publishers_that_come,
            args=(self._publishers.handler,),
            name="newest",
            daemon=True,
        )
        self._asker.start()

    def latest(self) -> bytes | None:
        """Return the newest value (of whichever key changed last), or None before there is one."""
        with self._changed:
            self._background.check()
            return self._latest

    def wait(self, timeout: float) -> bytes | None:
        """Wait until there is a value, at most `timeout` seconds; return it or None."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._latest is not None or self._closed.is_set() or self._background.failed, timeout
            )
            self._background.check()
            return self._latest

    def ask(self) -> None:
        """Ask for the newest values once more and return at once; they are taken as if they had been sent.

        For who knows from elsewhere that there is a newer one which did not come.
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
        """Stop listening; `latest` keeps what it has."""
        self._closed.set()
        self._cancel.cancel()
        for declared in (self._publishers, self._subscriber):
            undeclare_quietly(declared)
        with self._changed:
            self._changed.notify_all()
        if threading.current_thread() is not self._asker:
            self._asker.join(timeout=QUERY_SECONDS)

    def check(self) -> None:
        """Raise BackgroundFailed if a thread of this object failed, or `on_value` did."""
        self._background.check()

    def _wake(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _take_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._take(reply.ok)

    def _take(self, sample: zenoh.Sample) -> None:
        """Keep a value if it is newer than the one of its key; may be called by several threads."""
        with self._background.watched():
            self._keep(sample)

    def _keep(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.DELETE:  # the publisher has no value yet
            return
        try:
            edition, is_reminder = _edition_of(sample)
        except InvalidMessage as error:
            self._refusals.add(OTHERS, error)
            return
        key = str(sample.key_expr)
        if is_reminder:
            self._make_up_for(key, edition)
            return
        payload = sample.payload.to_bytes()
        with self._changed:
            if self._closed.is_set() or not self._is_newer(key, edition):
                return
            self._editions[key] = edition
            self._without_publisher.discard(key)
            self._latest = payload
            self._changed.notify_all()
            # Within the lock, so that two threads (put and reply) cannot hand values over in the wrong order.
            self._hand_over(payload)

    def _hand_over(self, payload: bytes) -> None:
        if self._on_value is None:
            return
        with self._background.watched():  # must not end the thread that keeps the newest value
            self._on_value(payload)

    def _make_up_for(self, key: str, edition: Edition) -> None:
        """Ask for a value that did not come though there is word of it, unless it was asked for just now."""
        now = time.monotonic()
        with self._changed:
            if not self._is_newer(key, edition) or now - self._asked_at < REMINDED_SECONDS:
                return
            self._asked_at = now
        self.ask()

    def _is_newer(self, key: str, edition: Edition) -> bool:
        known = self._editions.get(key)
        if known is None or edition > known:
            return True
        return key in self._without_publisher and edition.incarnation != known.incarnation

    def _ask_publishers_that_come(self, publishers: zenoh.handlers.Handler[zenoh.Sample]) -> None:
        """Ask every publisher that appears for its newest value, until closed."""
        with self._background.watched():
            while not self._closed.is_set():
                try:
                    event = publishers.recv()
                    key = str(event.key_expr)
                    if event.kind == zenoh.SampleKind.PUT:
                        self._ask(key)
                    else:
                        with self._changed:
                            self._without_publisher.add(key)
                except zenoh.ZError:
                    if self._closed.is_set() or self._session.is_closed():
                        return
                    raise

    def _ask(self, key: str) -> None:
        """Query the publisher of a key, again for some time if it does not answer."""
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


def _edition_of(sample: zenoh.Sample) -> tuple[Edition, bool]:
    """Return the edition of what came, and whether it is a reminder and not the value."""
    if sample.attachment is None:
        raise InvalidMessage("malformed", "a value without an edition")
    message = decode_message(athrl_pb2.Edition, sample.attachment.to_bytes())
    return Edition(message.incarnation, message.number), message.reminder
