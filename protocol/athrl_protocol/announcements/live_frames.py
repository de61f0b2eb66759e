"""Live frames of a service, which are only sent while they are watched."""

from __future__ import annotations

import logging
from collections.abc import Callable

import zenoh

from athrl_protocol.errors import InvalidMessage
from athrl_protocol.faults.background import Background
from athrl_protocol.faults.refusals import Refusals
from athrl_protocol.messages.frame import Frame, decode_frame, encode_frame
from athrl_protocol.messages.keys import Keys, role_and_name_of
from athrl_protocol.transport.closeable import Closeable
from athrl_protocol.transport.session import undeclare_quietly

_log = logging.getLogger(__name__)


class FramePublisher(Closeable):
    """Publishes the frames of one service; make frames only while `watched`."""

    def __init__(self, session: zenoh.Session, run: str, role: str, name: str) -> None:
        self._watched = False
        self._publisher = session.declare_publisher(
            Keys(run).live(role, name), congestion_control=zenoh.CongestionControl.DROP
        )
        self._matching = self._publisher.declare_matching_listener(self._take)

    @property
    def watched(self) -> bool:
        """Whether there is a watcher now."""
        return self._watched

    def publish(self, frame: Frame) -> None:
        """Send a frame if there is a watcher; a slow watcher misses frames."""
        if self._watched:
            self._publisher.put(encode_frame(frame))

    def close(self) -> None:
        """Stop publishing."""
        undeclare_quietly(self._matching)
        undeclare_quietly(self._publisher)

    def _take(self, status: zenoh.MatchingStatus) -> None:
        self._watched = status.matching


class FrameSubscription(Closeable):
    """A subscription until it is closed; made by `subscribe_frames`."""

    def __init__(self, session: zenoh.Session, key: str, on_frame: Callable[[Frame], None]) -> None:
        self._on_frame = on_frame
        self._refusals = Refusals("a frame", _log)
        self._background = Background("taking a frame", _log)
        self._subscriber = session.declare_subscriber(key, self._take)

    def close(self) -> None:
        """Stop watching."""
        undeclare_quietly(self._subscriber)

    def _take(self, sample: zenoh.Sample) -> None:
        with self._background.watched():
            self._receive(sample)

    def _receive(self, sample: zenoh.Sample) -> None:
        try:
            frame = decode_frame(sample.payload.to_bytes())
        except InvalidMessage as error:
            self._refusals.add(role_and_name_of(str(sample.key_expr))[1], error)
            return
        self._on_frame(frame)


def subscribe_frames(
    session: zenoh.Session, run: str, role: str, name: str, on_frame: Callable[[Frame], None]
) -> FrameSubscription:
    """Watch the frames of one service; `on_frame` is called with each from another thread."""
    return FrameSubscription(session, Keys(run).live(role, name), on_frame)
