"""Which segments are still needed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from athrl_learner.log.segments import LogPosition


class Needed(NamedTuple):
    """Numbers of needed segments: all from `oldest` on, and those in `named`."""

    oldest: int
    named: set[int]


def needed_segments(newest: Iterable[LogPosition], others: Iterable[LogPosition]) -> Needed:
    """The segments that the kept checkpoints need.

    A run may have to resume from one of the newest checkpoints with all later experience: these need all
    segments from their oldest sequence on. The others (the best one) need the segments that they name.
    Without checkpoints all segments are needed.
    """
    begins = [
        position.segments[0].number if position.segments else position.next_segment for position in newest
    ]
    named = {facts.number for position in others for facts in position.segments}
    return Needed(min(begins, default=0), named)
