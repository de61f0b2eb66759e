"""Publish and receive the newest value of one type; the base of all kinds of announcements."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

import zenoh

from athrl_protocol.announcements.latest_value import LatestPublisher, LatestSubscriber
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.faults.refusals import OTHERS, Refusals
from athrl_protocol.transport.closeable import Closeable

_log = logging.getLogger(__name__)
_Value = TypeVar("_Value")


class TypedPublisher(Generic[_Value], Closeable):
    """Publishes values of one type under one key."""

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        encode: Callable[[_Value], bytes],
        remind_seconds: float | None = None,
    ) -> None:
        self._encode = encode
        self._publisher = LatestPublisher(session, key, remind_seconds)

    def publish(self, value: _Value) -> None:
        """Make `value` the newest and send it to all subscribers."""
        self._publisher.publish(self._encode(value))

    def supersede(self, incarnation: int) -> None:
        """Send the newest value again, as newer than all of another publisher's incarnation."""
        self._publisher.supersede(incarnation)

    def close(self) -> None:
        """Stop publishing; late subscribers get no answer any more."""
        self._publisher.close()


class TypedSubscriber(Generic[_Value], Closeable):
    """Keeps the newest valid value of one type; an invalid one is logged and skipped.

    Args:
        session: an open session.
        key: key expression.
        decode: returns the value in a payload or raises InvalidMessage.
        on_value: called with every new value, from another thread.

    Other errors of `decode` or `on_value` are logged, and `newest` and `wait` raise BackgroundFailed.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        decode: Callable[[bytes], _Value],
        on_value: Callable[[_Value], None] | None = None,
    ) -> None:
        self._refusals = Refusals(f"a value under {key}", _log)
        self._decode = decode
        self._on_value = on_value
        self._changed = threading.Condition()
        self._newest: _Value | None = None
        self._closed = False
        self._subscriber = LatestSubscriber(session, key, self._take, on_failure=self._wake)

    def newest(self) -> _Value | None:
        """Return the newest value, or None before the first."""
        self._subscriber.check()
        with self._changed:
            return self._newest

    def wait(self, timeout: float) -> _Value | None:
        """Wait until there is a value, at most `timeout` seconds; return it or None."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._newest is not None or self._closed or self._subscriber.failed, timeout
            )
            self._subscriber.check()
            return self._newest

    def ask(self) -> None:
        """Query the newest value again, without waiting for it."""
        self._subscriber.ask()

    def close(self) -> None:
        """Stop listening; `newest` keeps its value."""
        self._subscriber.close()
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _wake(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _take(self, payload: bytes) -> None:
        try:
            value = self._decode(payload)
        except InvalidMessage as error:
            self._refusals.add(OTHERS, error)
            return
        with self._changed:
            self._newest = value
            self._changed.notify_all()
        if self._on_value is not None:
            self._on_value(value)
