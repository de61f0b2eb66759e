"""Metrics: each service publishes its numbers about once a second; without subscribers they are dropped."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import zenoh

from athrl_protocol.errors import InvalidMessage
from athrl_protocol.faults.background import Background
from athrl_protocol.faults.refusals import Refusals
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.keys import Keys, role_and_name_of
from athrl_protocol.messages.limits import LARGEST_NUMBERS
from athrl_protocol.messages.schema import check_numbers, check_text, decode_message, encode_message
from athrl_protocol.transport.closeable import Closeable
from athrl_protocol.transport.session import undeclare_quietly

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class MetricsReport:
    """Numbers of one service at one time.

    Attributes:
        role: learner, actor or evaluator.
        name: of the service.
        time: unix seconds.
        values: by the metric's name.
    """

    role: str
    name: str
    time: float
    values: dict[str, float]


class MetricsPublisher(Closeable):
    """Publishes the metrics of one service."""

    def __init__(self, session: zenoh.Session, run: str, role: str, name: str) -> None:
        self._role = role
        self._name = name
        self._publisher = session.declare_publisher(
            Keys(run).metrics(role, name), congestion_control=zenoh.CongestionControl.DROP
        )

    def publish(self, values: Mapping[str, float]) -> None:
        """Publish the values with the current time; never waits for a slow subscriber."""
        message = athrl_pb2.Metrics(role=self._role, name=self._name, time=time.time(), values=dict(values))
        self._publisher.put(encode_message(message))

    def close(self) -> None:
        """Stop publishing."""
        undeclare_quietly(self._publisher)


class MetricsSubscriber(Closeable):
    """Receives the metrics of all services of a run.

    Args:
        session: an open session, which stays the caller's.
        run: name of the run.
        on_metrics: called with each report, from another thread; its errors are logged in one line.
        role: receive those of services of this role only.
    """

    def __init__(
        self,
        session: zenoh.Session,
        run: str,
        on_metrics: Callable[[MetricsReport], None],
        role: str | None = None,
    ) -> None:
        keys = Keys(run)
        self._on_metrics = on_metrics
        self._refusals = Refusals("a report of metrics", _log)
        self._background = Background("taking a report of metrics", _log)
        self._subscriber = session.declare_subscriber(
            keys.every_metrics if role is None else keys.metrics_of(role), self._take
        )

    def close(self) -> None:
        """Stop listening."""
        undeclare_quietly(self._subscriber)

    def _take(self, sample: zenoh.Sample) -> None:
        with self._background.watched():
            self._receive(sample)

    def _receive(self, sample: zenoh.Sample) -> None:
        role, name = role_and_name_of(str(sample.key_expr))
        try:
            report = decode_metrics(sample.payload.to_bytes())
            # The access list lets a role write only under its own key, so the key identifies the sender.
            if (report.role, report.name) != (role, name):
                raise InvalidMessage("value", "metrics under the key of another service")
        except InvalidMessage as error:
            self._refusals.add(name, error)
            return
        self._on_metrics(report)


def decode_metrics(payload: bytes) -> MetricsReport:
    """Return the report in a message.

    Raises:
        InvalidMessage: it is no such message, too large, or has names or a time that are not valid.
    """
    message = decode_message(athrl_pb2.Metrics, payload, largest=LARGEST_NUMBERS)
    check_numbers("metrics", message.values)
    for kind, text in (("role", message.role), ("name", message.name)):
        check_text("metrics", kind, text)
    if not math.isfinite(message.time):
        raise InvalidMessage("value", f"metrics: time is {message.time}, should be unix seconds")
    return MetricsReport(message.role, message.name, message.time, dict(message.values))
