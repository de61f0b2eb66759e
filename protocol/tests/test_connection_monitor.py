"""The monitor of connections outlives what goes wrong in one session."""

from __future__ import annotations

import logging
import threading
from typing import Any

import pytest
from athrl_protocol.transport import connection_monitor

PATIENCE = 30.0


class Session:
    """Stands for a monitored session; `events` fails if `broken`."""

    def __init__(self, broken: bool) -> None:
        self.polls = threading.Semaphore(0)
        self._broken = broken

    def events(self) -> list[Any]:
        if self._broken:
            raise ValueError("no such event")
        return []

    def poll(self, events: list[Any]) -> None:
        assert events == []
        self.polls.release()


def test_session_whose_events_cannot_be_read_is_told_once_and_others_are_monitored(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(connection_monitor, "POLL_SECONDS", 0.01)
    monitor = connection_monitor._Monitor()
    sessions = [Session(broken=True), Session(broken=False)]
    for session in sessions:
        monitor.begin(session)  # type: ignore[arg-type]
    for session in sessions:
        for _ in range(3):
            assert session.polls.acquire(timeout=PATIENCE)
    monitor.end()
    (told,) = caplog.records
    assert told.levelno == logging.ERROR
    assert told.getMessage().startswith("the monitor of connections failed: ValueError: no such event")
