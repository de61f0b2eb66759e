"""Settings shared by all contestants, and the result of each."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Observation = dict[str, NDArray]
"""`image` uint8 [batch, S, S, 4] and `motion` float32 [batch, 2]."""

Act = Callable[[Observation], NDArray[np.float32]]
"""The greedy actions [batch, 2] within [-1, 1] of an observation."""


@dataclass(frozen=True)
class Comparison:
    """Town, training time, cores and scored episodes of the comparison."""

    town: str = "town03"
    vehicles: int = 100
    seconds: float = 600.0  # of training
    cores: int = 2
    seed: int = 0
    points: int = 8  # scores on the way and at the end, at equal distances
    episodes: int = 100
    first_seed: int = 700_000

    @property
    def training_seed(self) -> int:
        """The first environment's seed while a peer trains; the scored episodes' are below all of them."""
        return self.first_seed + self.episodes + 1_000 * (self.seed + 1)


@dataclass(frozen=True)
class Point:
    """Greedy scores of the policy at one time; `seconds` of training and `decisions` so far."""

    seconds: float
    decisions: int
    scores: dict[str, float]

    def row(self) -> dict[str, Any]:
        """As one flat table row."""
        return {**self.scores, "decisions": self.decisions, "seconds": round(self.seconds, 1)}


@dataclass(frozen=True)
class Learned:
    """The result of one contestant; the last point is its row in the table."""

    comparison: Comparison
    points: list[Point]
    remarks: dict[str, Any] = field(default_factory=dict)

    def write(self, path: Path) -> None:
        """Write it as JSON."""
        path.write_text(json.dumps(asdict(self), indent=1) + "\n")

    @classmethod
    def read(cls, path: Path) -> Learned:
        """Read what `write` wrote."""
        content = json.loads(path.read_text())
        points = [Point(**point) for point in content["points"]]
        return cls(Comparison(**content["comparison"]), points, content["remarks"])


class Training:
    """A peer's training time, with intermediate scoring, which does not count.

    The peer calls `begin` before its first decision, `goes_on` after each and `end` after its last update.
    """

    def __init__(self, comparison: Comparison, score: Callable[[Act], dict[str, float]]) -> None:
        self.comparison = comparison
        self.points: list[Point] = []
        self._score = score
        self._began = 0.0
        self._paused = 0.0
        self._parts = 0  # parts of the time that were scored

    def begin(self) -> None:
        """Start the clock."""
        self._began = time.monotonic()
        self._paused = 0.0

    @property
    def seconds(self) -> float:
        """Seconds of training so far."""
        return time.monotonic() - self._began - self._paused

    @property
    def progress(self) -> float:
        """Elapsed share of the time, 0 to 1."""
        return min(1.0, self.seconds / self.comparison.seconds)

    def falling(self, initial: float) -> float:
        """A learning rate that falls linearly to a tenth at the end of the time."""
        return initial * (1.0 - 0.9 * self.progress)

    def goes_on(self, decisions: int, act: Act) -> bool:
        """Score the policy if that is due; return whether there is time left."""
        parts = int(self.seconds / self.comparison.seconds * self.comparison.points)
        if self._parts < parts < self.comparison.points:
            self._parts = parts
            self._add_point(decisions, act)
        return self.seconds < self.comparison.seconds

    def end(self, decisions: int, act: Act) -> None:
        """Score the final policy."""
        self._add_point(decisions, act)

    def _add_point(self, decisions: int, act: Act) -> None:
        with self._pause() as seconds:
            self.points.append(Point(seconds, decisions, self._score(act)))
        print(f"{seconds:.0f} s, {decisions} decisions: {self.points[-1].scores}", flush=True)

    @contextmanager
    def _pause(self) -> Iterator[float]:
        """Yield the seconds of training so far and do not count those inside the block."""
        began = time.monotonic()
        try:
            yield self.seconds
        finally:
            self._paused += time.monotonic() - began
