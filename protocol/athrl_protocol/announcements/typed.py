"""Publish and receive the newest value of one type; the kinds of announcements are made from these two."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

import zenoh

from athrl_protocol.closing import Closing
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.newest import NewestPublisher, NewestSubscriber
from athrl_protocol.refusals import OTHERS, Refusals

_log = logging.getLogger(__name__)
_Value = TypeVar("_Value")


class TypedPublisher(Generic[_Value], Closing):
    """Publishes values of one type under one key."""

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        encode: Callable[[_Value], bytes],
        remind_seconds: float | None = None,
    ) -> None:
        self._encode = encode
        self._publisher = NewestPublisher(session, key, remind_seconds)

    def publish(self, value: _Value) -> None:
        """Make `value` the newest and send it to all."""
        self._publisher.publish(self._encode(value))

    def close(self) -> None:
        """Stop publishing; latecomers get no answer any more."""
        self._publisher.close()


class TypedSubscriber(Generic[_Value], Closing):
    """Keeps the newest valid value of one type; an invalid one is logged and left out.

    Args:
        session: an open session.
        key: key expression.
        decode: returns the value in a payload or raises InvalidMessage.
        on_value: called with every value that is taken, from another thread.

    What `decode` or `on_value` raises beyond that is logged, and `newest` and `wait` raise BackgroundFailed.
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
        self._subscriber = NewestSubscriber(session, key, self._take)

    def newest(self) -> _Value | None:
        """Return the newest value, or None before there is one."""
        self._subscriber.check()
        with self._changed:
            return self._newest

    def wait(self, timeout: float) -> _Value | None:
        """Wait until there is a value, at most `timeout` seconds; return it or None."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._closed, timeout)
            self._subscriber.check()
            return self._newest

    def ask(self) -> None:
        """Ask for the newest value once more, without waiting for it."""
        self._subscriber.ask()

    def close(self) -> None:
        """Stop listening; `newest` keeps what it has."""
        self._subscriber.close()
        with self._changed:
            self._closed = True
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
