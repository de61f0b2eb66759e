"""The end of the warm-up: an actor drives no more at random than the run needs.

A busy learner takes experience in late. An actor that drove ahead as far as it may hold chunks would do so
with a policy that decides nothing yet, and the learner would have all of that to take in before it trains.
"""

from __future__ import annotations

from collections import deque

from athrl_protocol import Chunk, Phase, RunState


class WarmUp:
    """Adds up what the learner has told that it has, and what this actor has made besides.

    What other actors have on the way is not known: several that start together drive somewhat more than the
    run needs.

    Args:
        decisions: random decisions of all actors before training; without any, training needs one.
    """

    def __init__(self, decisions: int) -> None:
        self._decisions = max(1, decisions)
        self._unsettled: deque[int] = deque()  # decisions of each submitted chunk, the oldest first
        self._settled_chunks = 0
        self._settled_since = 0  # decisions, since the newest state came
        self._state: RunState | None = None

    def submitted(self, chunk: Chunk) -> None:
        """The uploader has taken a chunk."""
        self._unsettled.append(chunk.length)

    def settled(self, chunks: int) -> None:
        """So many chunks of this actor have been acknowledged or given up, all in all."""
        for _ in range(min(chunks - self._settled_chunks, len(self._unsettled))):
            self._settled_since += self._unsettled.popleft()
            self._settled_chunks += 1

    def is_driven(self, state: RunState | None, open_decisions: int) -> bool:
        """Whether all random decisions are made, so that a random policy need not drive on.

        `state` is the newest, and `open_decisions` are those that are not yet in a submitted chunk. What was
        settled since the state came is counted until the next one: if it was lost, driving continues then.
        """
        if state is not self._state:
            self._state, self._settled_since = state, 0
        accepted = 0 if state is None else state.environment_steps
        if state is not None and state.phase is Phase.WARMING_UP and accepted >= self._decisions:
            return False  # the run was resumed with a longer warm-up
        return accepted + self._settled_since + sum(self._unsettled) + open_decisions >= self._decisions
