"""Prometheus' families of samples, made of the values that services report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric as Family

from athrl_protocol.monitoring.table import Group, Metric

MOST_SERIES = 50
"""Of one metric by its labels. One with more is left out: names come from other processes, and each series
costs the Prometheus that keeps it."""

Labels = Mapping[str, str]


class Place(NamedTuple):
    """What is measured: a metric, and the parts of its name that vary."""

    metric: Metric
    labels: tuple[tuple[str, str], ...]


Values = dict[Place, float]


class Reader:
    """Finds the metrics of some groups in the values that a service reports."""

    def __init__(self, groups: Sequence[Group]) -> None:
        metrics = [metric for group in groups for metric in group.metrics]
        self._fixed = {metric.name: metric for metric in metrics if not metric.labels}
        self._varying = [metric for metric in metrics if metric.labels]

    def knows(self, name: str) -> bool:
        """Whether the table has a metric of this name."""
        return name in self._fixed or self._varying_place(name) is not None

    def read(self, values: Mapping[str, float]) -> Values:
        """Return what the table knows, without values that are not finite.

        Nothing of a metric with labels is returned if there are more than `MOST_SERIES`.
        """
        known: Values = {}
        varying: dict[Metric, Values] = {}
        for name, value in values.items():
            if not math.isfinite(value):
                continue
            if name in self._fixed:
                known[Place(self._fixed[name], ())] = value
                continue
            place = self._varying_place(name)
            if place is not None:
                varying.setdefault(place.metric, {})[place] = value
        for of_metric in varying.values():
            if len(of_metric) <= MOST_SERIES:
                known |= of_metric
        return known

    def _varying_place(self, name: str) -> Place | None:
        for metric in self._varying:
            match = metric.pattern.fullmatch(name)
            if match is not None:
                return Place(metric, tuple(match.groupdict().items()))
        return None


def families(prefix: str, values: Iterable[tuple[Labels, Values]], common: Labels) -> Iterator[Family]:
    """Yield a family for each metric of which there is a value.

    Args:
        prefix: of the names.
        values: with labels beside those of their places.
        common: labels of every sample.
    """
    found: dict[Metric, list[tuple[Labels, float]]] = {}
    for labels, of_these in values:
        for place, value in of_these.items():
            found.setdefault(place.metric, []).append(({**common, **labels, **dict(place.labels)}, value))
    for metric, samples in found.items():
        yield family(prefix, metric, samples)


def family(prefix: str, metric: Metric, samples: Iterable[tuple[Labels, float]]) -> Family:
    """Return the family of one metric."""
    kind = CounterMetricFamily if metric.counts else GaugeMetricFamily
    made: Family = kind(prefix + metric.exposed, metric.meaning)
    for labels, value in samples:
        made.add_sample(prefix + metric.exposed, dict(labels), value)
    return made
