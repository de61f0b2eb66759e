"""`athrl actor`, but it records the chunks that it made and those that were acknowledged.

    python -m tests.chaos.recording_actor FILE actor --connect ...

Each line of the file is written at once as it happens, so it survives a kill of the actor:

    event time actor incarnation sequence length digest

The event is produced, acknowledged, refused, given-up or unencoded, the time the machine's monotonic clock. A
chunk that was given up before it was encoded is "unencoded", with length 0 and digest -. An actor that ends
gracefully adds its counters: statistics time actor incarnation JSON.
"""

from __future__ import annotations

import json
import os
import sys
import time
from dataclasses import asdict

import athrl_protocol.delivery.upload
from athrl.command import main
from athrl_protocol.delivery.upload_window import Reason, UploadWindow

from tests.chaos.content import Content, Identity, read_chunk


class RecordingWindow(UploadWindow):
    """The uploader's window, which records the outcomes of its chunks."""

    descriptor = -1

    def __init__(self) -> None:
        super().__init__()
        self._known: dict[int, tuple[Identity, Content]] = {}
        self._last: Identity | None = None

    def put(self, sequence: int, encoded: bytes) -> None:
        if sequence in self._held:
            identity, content = read_chunk(encoded)
            self._known[sequence] = (identity, content)
            self._last = identity
            self._record("produced", sequence)
        super().put(sequence, encoded)

    def acknowledge(self, next_sequence: int) -> int:
        before = list(self._held)
        settled = super().acknowledge(next_sequence)
        self._settle("acknowledged", before)
        return settled

    def give_up(self, sequence: int) -> None:
        before = list(self._held)
        super().give_up(sequence)
        self._settle("refused", before)

    def give_up_all(self, reason: Reason) -> None:
        before = list(self._held)
        super().give_up_all(reason)
        self._settle("given-up", before)
        if reason == "closed" and self._last is not None:
            counters = json.dumps(asdict(self.statistics()), separators=(",", ":"))
            self._write("statistics", self._last.actor, self._last.incarnation, counters)

    def _settle(self, event: str, before: list[int]) -> None:
        for sequence in before:
            if sequence in self._held:
                continue
            if sequence in self._known:
                self._record(event, sequence)
                del self._known[sequence]
            elif self._last is not None:
                self._write("unencoded", self._last.actor, self._last.incarnation, sequence, 0, "-")

    def _record(self, event: str, sequence: int) -> None:
        identity, content = self._known[sequence]
        self._write(event, *identity, *content)

    def _write(self, event: str, *words: object) -> None:
        line = " ".join(map(str, (event, time.monotonic(), *words))) + "\n"
        os.write(self.descriptor, line.encode())


def run_actor() -> None:
    """Run the actor."""
    path = sys.argv.pop(1)
    RecordingWindow.descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
    athrl_protocol.delivery.upload.UploadWindow = RecordingWindow  # type: ignore[misc]
    main()


if __name__ == "__main__":
    run_actor()
