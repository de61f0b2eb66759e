"""Reads the actors' records, also while they are being written."""

from __future__ import annotations

import json
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.chaos.content import Content, Identity

Life = tuple[str, int]
"""An actor and its incarnation."""


@dataclass
class Evidence:
    """The records so far of the actors whose files are in `folder`.

    Attributes:
        produced: every chunk that was made, with its content.
        settled: event -> chunks: acknowledged, refused, given-up, unencoded.
        acknowledged_at: moments (monotonic seconds) of each actor's acknowledgements, in order.
        counters: counters of the processes that ended gracefully.
    """

    folder: Path
    produced: dict[Identity, Content] = field(default_factory=dict)
    settled: dict[str, dict[Identity, Content]] = field(default_factory=lambda: defaultdict(dict))
    acknowledged_at: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    counters: dict[Life, dict[str, Any]] = field(default_factory=dict)
    _read: dict[Path, int] = field(default_factory=dict)

    def read(self) -> None:
        """Read new records."""
        for path in sorted(self.folder.glob("*.txt")):
            with path.open("rb") as file:
                file.seek(self._read.get(path, 0))
                for line in file:
                    if not line.endswith(b"\n"):
                        break
                    self._take(line.decode().split(maxsplit=6))
                    self._read[path] = self._read.get(path, 0) + len(line)

    def last_acknowledgement(self, actor: str | None = None) -> float:
        """Return the time of the newest one, of all actors or of one; -1 if there is none."""
        self.read()
        names = [actor] if actor else list(self.acknowledged_at)
        return max(
            (self.acknowledged_at[name][-1] for name in names if self.acknowledged_at[name]), default=-1
        )

    def _take(self, words: list[str]) -> None:
        event, moment, actor, incarnation, rest = *words[:4], words[4]
        if event == "statistics":
            self.counters[actor, int(incarnation)] = json.loads(rest)
            return
        identity = Identity(actor, int(incarnation), int(rest))
        content = Content(int(words[5]), words[6].strip())
        if event == "produced":
            self.produced[identity] = content
            return
        self.settled[event][identity] = content
        if event == "acknowledged":
            self.acknowledged_at[actor].append(float(moment))
