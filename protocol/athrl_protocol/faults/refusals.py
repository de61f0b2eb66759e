"""Refused messages: counted by reason and sender, and logged in one line."""

from __future__ import annotations

import logging
import threading

from athrl_protocol.errors import InvalidMessage, ProtocolError
from athrl_protocol.faults.bounded_log import BoundedLog, shortened
from athrl_protocol.messages.keys import check_name

SENDERS_KEPT = 32
OTHERS = "others"
"""Name for further senders, and for those with invalid names."""


class Refusals:
    """Counts refused messages. May be used by several threads.

    Args:
        kind: expected kind of the messages, for the log.
        log: gets refusals as warnings, each reason of a sender at most once in ten seconds.
    """

    def __init__(self, kind: str, log: logging.Logger) -> None:
        self._kind = kind
        self._say = BoundedLog(log.warning)
        self._counts: dict[str, dict[str, int]] = {}  # sender -> reason -> messages
        self._lock = threading.Lock()

    def add(self, sender: str, error: InvalidMessage) -> None:
        """Count a message and log why it was refused; `sender` is its own name for itself."""
        with self._lock:
            name = self._name(sender)
            of_sender = self._counts.setdefault(name, {})
            of_sender[error.reason] = of_sender.get(error.reason, 0) + 1
        self._say(f"{self._kind} of {name} was refused ({error.reason}): {shortened(str(error))}")

    def by_reason(self) -> dict[str, int]:
        """Return the counts of all senders together."""
        totals: dict[str, int] = {}
        for reasons in self.by_sender().values():
            for reason, count in reasons.items():
                totals[reason] = totals.get(reason, 0) + count
        return totals

    def by_sender(self) -> dict[str, dict[str, int]]:
        """Return sender -> reason -> count."""
        with self._lock:
            return {sender: dict(reasons) for sender, reasons in self._counts.items()}

    def _name(self, sender: str) -> str:
        try:
            check_name("sender", sender)
        except ProtocolError:
            return OTHERS
        full = len(self._counts) >= SENDERS_KEPT
        return OTHERS if full and sender not in self._counts else sender
