"""Outages, recovery times, and the longest stall without a fault."""

from __future__ import annotations

import itertools
import statistics
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypedDict

from tests.chaos.schedule import Group


@dataclass
class Outage:
    """A group of faults as it happened; all times are the machine's monotonic seconds.

    Attributes:
        group: the group of faults.
        began: when the first fault began.
        ended: when the last fault ended: killed services were restarted, paused ones resumed.
        recovered: when all targets worked again; None if that was not waited for.
    """

    group: Group
    began: float
    ended: float
    recovered: float | None = None

    @property
    def kind(self) -> str:
        """Kind of the outage, for a table."""
        return self.group.faults[0].kind.value if len(self.group.faults) == 1 else "two at once"


class Recovery(TypedDict):
    """Recovery times of one kind of fault, seconds."""

    count: int
    median_s: float
    worst_s: float


def recovery_table(outages: Iterable[Outage]) -> dict[str, Recovery]:
    """Return recovery times by kind, from the end of a fault until its targets work again."""
    seconds: dict[str, list[float]] = defaultdict(list)
    for outage in outages:
        if outage.recovered is not None:
            seconds[outage.kind].append(outage.recovered - outage.ended)
    return {
        kind: Recovery(
            count=len(times), median_s=round(statistics.median(times), 2), worst_s=round(max(times), 2)
        )
        for kind, times in sorted(seconds.items())
    }


def longest_stall(moments: Iterable[float], outages: Iterable[Outage], began: float, ended: float) -> float:
    """Return the longest time without an acknowledgement outside of outages.

    An outage lasts from the beginning of a fault until its targets work again, or, if that was not waited
    for, until the next faults.

    Args:
        moments: times of all acknowledgements.
        outages: all outages in order; they do not overlap.
        began: when all services worked.
        ended: when the end was requested.
    """
    calm: list[tuple[float, float]] = []
    since: float | None = began
    for outage in outages:
        if since is not None and outage.began > since:
            calm.append((since, outage.began))
        since = outage.recovered
    if since is not None and ended > since:
        calm.append((since, ended))
    known = sorted(moments)
    return max((_longest_gap(known, *stretch) for stretch in calm), default=0.0)


def _longest_gap(moments: list[float], start: float, end: float) -> float:
    inside = [moment for moment in moments if start <= moment <= end]
    marks = [start, *inside, end]
    return max(later - earlier for earlier, later in itertools.pairwise(marks))
