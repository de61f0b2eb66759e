"""How far an uploader may run ahead, depending on the learner's answers. No network, no threads.

Without answers an actor drives on until its capacity is reached. A busy learner needs no more chunks now:
more held chunks would be of an old policy when they are taken. So only a few chunks are held then, and are
sent one by one; with each acknowledged chunk one more may be held. For a learner that takes everything, twice
its credits may be held: some chunks are ready while others are in flight, so actor and learner work at the
same time.
"""

from __future__ import annotations

import math

from athrl_protocol.delivery.bundle import MOST_CHUNKS

HELD_WHILE_BUSY = 8
SHORTEST_BUSY_PAUSE_SECONDS = 0.01
LONGEST_BUSY_PAUSE_SECONDS = 0.05


class Pace:
    """The current bounds of an uploader.

    Args:
        capacity: most chunks that are held.

    Raises:
        ValueError: the capacity is below 1.
    """

    def __init__(self, capacity: int) -> None:
        if capacity < 1:
            raise ValueError(f"capacity is {capacity}, should be at least 1")
        self._capacity = capacity
        self._credits = 1
        self._answers = False  # whether the learner answered the last query
        self._trusted = math.inf  # most chunks to hold after it was busy
        self._probing = True  # until a chunk is acknowledged
        self._pause = SHORTEST_BUSY_PAUSE_SECONDS

    @property
    def probing(self) -> bool:
        """Whether chunks are sent one by one, because it is not known whether they are accepted."""
        return self._probing

    @property
    def max_held(self) -> int:
        """Most chunks that may be held without an acknowledgement."""
        if not self._answers:
            return self._capacity
        return int(min(self._capacity, 2 * self._credits, self._trusted))

    @property
    def max_in_flight(self) -> int:
        """Most chunks that may be in flight."""
        return 1 if self._probing else self._credits

    @property
    def max_per_query(self) -> int:
        """Most chunks in one query, so that another query can be in flight."""
        return 1 if self._probing else max(1, min(MOST_CHUNKS, self._credits // 2))

    def acknowledged(self, chunks: int, credits: int) -> None:
        """The learner has acknowledged so many new chunks, and gives credits."""
        self._answers = True
        self._credits = max(1, credits)
        self._trusted += chunks

    def answered(self) -> None:
        """A query was answered and nothing has to be sent again."""
        self._answers = True
        self._probing = False
        self._pause = SHORTEST_BUSY_PAUSE_SECONDS

    def rewound(self) -> None:
        """The learner expects an earlier chunk first; it has answered."""
        self._answers = True

    def busy(self) -> float:
        """The learner has no room; return seconds to wait before the next query."""
        self._answers = self._probing = True
        self._trusted = HELD_WHILE_BUSY
        pause, self._pause = self._pause, min(2 * self._pause, LONGEST_BUSY_PAUSE_SECONDS)
        return pause

    def silent(self) -> None:
        """There was no answer."""
        self._answers, self._probing = False, True
