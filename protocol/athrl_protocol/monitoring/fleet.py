"""The figures of all actors at the learner's endpoint, so that no actor has to be scraped.

Few actors are shown one by one, `athrl_actor_...{actor="actor-1"}`. At any number there are least, mean and
most of a gauge, `athrl_actors_...{statistic="mean"}`, and the sum of a counter, `athrl_actors_..._total`, to
which actors that have left still count. So the number of series does not grow with that of actors.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from prometheus_client.metrics_core import Metric as Family
from prometheus_client.registry import Collector

from athrl_protocol.announcements.metrics import MetricsReport
from athrl_protocol.monitoring.families import MOST_SERIES, Labels, Place, Reader, Values, families, family
from athrl_protocol.monitoring.table import ACTOR, REPORTING, Metric

NAMED = 50
"""With more actors that report, none is shown by its name."""
REMEMBERED = 10_000
"""Actors whose counts are kept, so that one that is silent for a while is not counted twice."""
MOST_SUMS = 1_000
"""Counters of all actors, with their labels, that are summed up."""
SILENT_SECONDS = 10.0
"""After which an actor's gauges are old; actors report once a second."""

OF_EACH = ACTOR[0].prefix
OF_ALL = "athrl_actors_"

_STATISTICS: dict[str, Callable[[list[float]], float]] = {
    "min": min,
    "mean": lambda values: sum(values) / len(values),
    "max": max,
}


@dataclass(frozen=True)
class _Actor:
    heard_at: float
    values: Values


class ActorFigures(Collector):
    """Keeps the newest report of each actor, and the sums of their counters.

    Args:
        labels: of every sample, such as the run.
        clock: seconds, monotonic.
    """

    def __init__(self, labels: Labels, clock: Callable[[], float] = time.monotonic) -> None:
        self._labels = labels
        self._clock = clock
        self._reader = Reader(ACTOR)
        self._actors: OrderedDict[str, _Actor] = OrderedDict()  # the longest unheard first
        self._sums: Values = {}
        self._lock = threading.Lock()

    def take(self, report: MetricsReport) -> None:
        """Note an actor's report; may be called from any thread."""
        values = self._reader.read(report.values)
        with self._lock:
            known = self._actors.pop(report.name, None)
            self._count({} if known is None else known.values, values)
            self._actors[report.name] = _Actor(self._clock(), values)
            if len(self._actors) > REMEMBERED:
                self._actors.popitem(last=False)

    def collect(self) -> Iterator[Family]:
        """Yield the families of all actors, and of each one of few; called by a scrape, in its thread."""
        with self._lock:
            sums = _bounded(self._sums)
            heard = self._heard()
        yield family(OF_ALL, REPORTING, [(self._labels, len(heard))])
        together = _gauges_of_all(heard.values())
        statistics = [({"statistic": name}, values) for name, values in together.items()]
        yield from families(OF_ALL, [({}, sums), *statistics], self._labels)
        if len(heard) <= NAMED:
            each = [({"actor": name}, values) for name, values in heard.items()]
            yield from families(OF_EACH, each, self._labels)

    def _heard(self) -> dict[str, Values]:
        """The values of the actors that reported recently."""
        oldest = self._clock() - SILENT_SECONDS
        return {name: actor.values for name, actor in self._actors.items() if actor.heard_at >= oldest}

    def _count(self, before: Values, now: Values) -> None:
        """Add what an actor counted since its last report; one that was started again began at 0."""
        for place, value in now.items():
            if place.metric.counts and (place in self._sums or len(self._sums) < MOST_SUMS):
                earlier = before.get(place, 0.0)
                grown = value - earlier if value >= earlier else value
                self._sums[place] = self._sums.get(place, 0.0) + grown


def _gauges_of_all(actors: Iterable[Values]) -> dict[str, Values]:
    """Least, mean and most of each gauge, over the actors that have it."""
    gathered: dict[Place, list[float]] = {}
    for values in actors:
        for place, value in values.items():
            if not place.metric.counts:
                gathered.setdefault(place, []).append(value)
    return {
        name: _bounded({place: statistic(values) for place, values in gathered.items()})
        for name, statistic in _STATISTICS.items()
    }


def _bounded(values: Values) -> Values:
    """The values without metrics that have more than `MOST_SERIES`: each actor may bring other labels."""
    series: Counter[Metric] = Counter(place.metric for place in values)
    return {place: value for place, value in values.items() if series[place.metric] <= MOST_SERIES}
