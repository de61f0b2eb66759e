"""Which segments are still needed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from athrl_learner.segments.facts import LogPosition


class Needed(NamedTuple):
    """Segments with these numbers are needed: all from `oldest` on, and those that are `named`."""

    oldest: int
    named: set[int]


def needed_segments(newest: Iterable[LogPosition], others: Iterable[LogPosition]) -> Needed:
    """Which segments the kept checkpoints need.

    From one of the newest checkpoints a run may have to go on, with everything behind it: they need all from
    their oldest sequence on. The others (the best one) need what they name. Without checkpoints all are
    needed.
    """
    begins = [
        position.segments[0].number if position.segments else position.next_segment for position in newest
    ]
    named = {facts.number for position in others for facts in position.segments}
    return Needed(min(begins, default=0), named)
