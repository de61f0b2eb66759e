"""What an endpoint shows: the newest values of its own service, and the newest scores of each driver."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePath

from prometheus_client.metrics_core import Metric as Family
from prometheus_client.registry import Collector

from athrl_protocol.announcements.evaluation import EvaluationResult
from athrl_protocol.monitoring.families import MOST_SERIES, Labels, Reader, families, family
from athrl_protocol.monitoring.table import REPORTED_AT, SCORES, Group


class ServiceFigures(Collector):
    """The newest values of one service.

    Args:
        groups: of the table, what the service reports.
        labels: of every sample, such as the run.
    """

    def __init__(self, groups: Sequence[Group], labels: Labels) -> None:
        self._prefix = groups[0].prefix
        self._reader = Reader(groups)
        self._labels = labels
        self._newest: tuple[float, Mapping[str, float]] | None = None

    def show(self, values: Mapping[str, float]) -> None:
        """Show these values from now on; they must not change afterwards."""
        self._newest = time.time(), values

    def collect(self) -> Iterator[Family]:
        """Yield the families of the newest values; called by a scrape, in its thread."""
        if self._newest is None:
            return
        reported_at, values = self._newest
        yield family(self._prefix, REPORTED_AT, [(self._labels, reported_at)])
        yield from families(self._prefix, [({}, self._reader.read(values))], self._labels)


class ScoreFigures(Collector):
    """The newest scores of each driver, over all towns (the label `town` is empty) and in each of several."""

    def __init__(self, labels: Labels) -> None:
        self._reader = Reader(SCORES)
        self._labels = labels
        self._newest: dict[str, EvaluationResult] = {}
        self._lock = threading.Lock()

    def take(self, result: EvaluationResult) -> None:
        """Show the result instead of the driver's earlier one; may be called from any thread."""
        with self._lock:
            if result.driver in self._newest or len(self._newest) < MOST_SERIES:
                self._newest[result.driver] = result

    def collect(self) -> Iterator[Family]:
        """Yield the families of all scores."""
        with self._lock:
            results = list(self._newest.values())
        values = (
            ({"driver": result.driver, "town": town}, self._reader.read(scores))
            for result in results
            for town, scores in _by_town(result.scores).items()
        )
        yield from families(SCORES[0].prefix, values, self._labels)


def _by_town(scores: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """The scores over all towns, under an empty name, and of each of a few towns."""
    by_town: dict[str, dict[str, float]] = {}
    for name, value in scores.items():
        town, _, score = name.rpartition("/")
        label = PurePath(town).name
        if label in by_town or len(by_town) < MOST_SERIES:
            by_town.setdefault(label, {})[score] = value
    return by_town
