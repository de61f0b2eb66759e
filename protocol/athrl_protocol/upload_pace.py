"""How far an uploader may run ahead, from what its learner answered. No network, no threads.

While nobody answers an actor drives on until it holds all that it has room for. A learner that says "busy"
has no use for more now: what piled up would be of an old policy when it is taken. So a few chunks are held
then, and go one by one; with each that is taken without another "busy" one more may be held. For a learner
that takes everything it is twice the credits it gives: some chunks are ready while others are under way, and
actor and learner work at the same time and not by turns.
"""

from __future__ import annotations

import math

from athrl_protocol.delivery import MOST_CHUNKS

HELD_WHILE_BUSY = 8
SHORTEST_BUSY_PAUSE_SECONDS = 0.01
LONGEST_BUSY_PAUSE_SECONDS = 0.05


class Pace:
    """The bounds of the moment.

    Args:
        capacity: chunks that are held at most.

    Raises:
        ValueError: that is none.
    """

    def __init__(self, capacity: int) -> None:
        if capacity < 1:
            raise ValueError(f"capacity is {capacity}, should be at least 1")
        self._capacity = capacity
        self._credits = 1
        self._answers = False  # whether the learner answered last time
        self._trusted = math.inf  # chunks to be held, since it was busy last
        self._probing = True  # until a chunk is taken
        self._pause = SHORTEST_BUSY_PAUSE_SECONDS

    @property
    def probing(self) -> bool:
        """Whether chunks go one by one, since nobody knows whether they are taken."""
        return self._probing

    @property
    def most_held(self) -> int:
        """Chunks that may be held, not acknowledged."""
        if not self._answers:
            return self._capacity
        return int(min(self._capacity, 2 * self._credits, self._trusted))

    @property
    def most_under_way(self) -> int:
        """Chunks that may be under way."""
        return 1 if self._probing else self._credits

    @property
    def most_together(self) -> int:
        """Chunks that go in one query, so that another one can be under way."""
        return 1 if self._probing else max(1, min(MOST_CHUNKS, self._credits // 2))

    def took(self, chunks: int, credits: int) -> None:
        """The learner has acknowledged so many chunks that it had not before, and gives credits."""
        self._answers = True
        self._credits = max(1, credits)
        self._trusted += chunks

    def went_well(self) -> None:
        """A query was answered, and nothing has to be sent again."""
        self._answers = True
        self._probing = False
        self._pause = SHORTEST_BUSY_PAUSE_SECONDS

    def rewound(self) -> None:
        """The learner wants something else first; it answers, and that is all."""
        self._answers = True

    def busy(self) -> float:
        """The learner has no room; returns seconds to wait before it is asked again."""
        self._answers = self._probing = True
        self._trusted = HELD_WHILE_BUSY
        pause, self._pause = self._pause, min(2 * self._pause, LONGEST_BUSY_PAUSE_SECONDS)
        return pause

    def silent(self) -> None:
        """Nobody answered."""
        self._answers, self._probing = False, True
