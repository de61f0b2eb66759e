"""Which chunks the learner has: the next sequence of each (actor, incarnation). No network, no threads."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from athrl_protocol.chunk import Chunk
from athrl_protocol.errors import InvalidMessage

# More restarts of one actor than this, and a chunk of the first one may be under way no more.
INCARNATIONS_KEPT = 64


@dataclass(frozen=True)
class Known:
    """The chunk was taken in before; everything below `next_sequence` was."""

    next_sequence: int


@dataclass(frozen=True)
class Gap:
    """Chunks before this one are missing and the actor still has them, from `expected_sequence` on."""

    expected_sequence: int


@dataclass(frozen=True)
class New:
    """The chunk is the next one; `lost` before it are gone, because the actor does not hold them any more."""

    lost: int


@dataclass
class Totals:
    """What became of all chunks of the run; together they are all sequences below the ledger's next ones.

    Attributes:
        stored: chunks that were taken in.
        transitions: valid steps in them.
        refused: chunks that did not fit the run and are settled by that.
        lost: chunks that are not here and that their actor does not hold any more.
    """

    stored: int = 0
    transitions: int = 0
    refused: int = 0
    lost: int = 0


class Ledger:
    """Judges whether a chunk is new, and remembers what was taken in.

    Args:
        saved: what `to_json` returned, from a checkpoint.
        totals: what `totals` was as a dictionary at the same moment.

    Raises:
        ValueError: `saved` is not such a thing.
        TypeError: `totals` is not such a thing.
    """

    def __init__(self, saved: dict[str, Any] | None = None, totals: dict[str, int] | None = None) -> None:
        self.totals = Totals(**(totals or {}))
        self._next: dict[str, dict[int, int]] = {}  # actor -> incarnation -> next sequence
        for actor, incarnations in (saved or {}).items():
            self._next[actor] = {int(number): int(following) for number, following in incarnations.items()}

    def to_json(self) -> dict[str, dict[str, int]]:
        """Return actor -> incarnation -> next sequence, for a checkpoint."""
        return {
            actor: {str(number): following for number, following in incarnations.items()}
            for actor, incarnations in self._next.items()
        }

    def next_sequence(self, actor: str, incarnation: int) -> int:
        """Return the first sequence that was not taken in."""
        return self._next.get(actor, {}).get(incarnation, 0)

    def judge(self, chunk: Chunk) -> Known | Gap | New:
        """Say whether a chunk may be taken in now.

        A learner that went back to an older checkpoint misses chunks that it had acknowledged. Their actor
        has dropped them and says so by `oldest_held`; they are lost, and what follows is new.

        Raises:
            InvalidMessage: the chunk says that its actor does not hold it.
        """
        if chunk.oldest_held > chunk.sequence:
            raise InvalidMessage(
                "value", f"chunk: oldest_held is {chunk.oldest_held}, above its sequence {chunk.sequence}"
            )
        expected = self.next_sequence(chunk.actor, chunk.incarnation)
        if chunk.sequence < expected:
            return Known(expected)
        reachable = max(expected, chunk.oldest_held)
        if chunk.sequence > reachable:
            return Gap(reachable)
        return New(lost=reachable - expected)

    def record(self, chunk: Chunk) -> int:
        """Remember that a chunk was taken in, and return the next sequence; those missing before are lost."""
        self.totals.stored += 1
        self.totals.transitions += chunk.length
        return self._settle(chunk.actor, chunk.incarnation, chunk.sequence)

    def refuse(self, actor: str, incarnation: int, sequence: int) -> int:
        """Remember that a chunk was refused for good; return the next sequence."""
        self.totals.refused += 1
        return self._settle(actor, incarnation, sequence)

    def totals_to_json(self) -> dict[str, int]:
        """Return the totals, for a checkpoint."""
        return asdict(self.totals)

    def _settle(self, actor: str, incarnation: int, sequence: int) -> int:
        incarnations = self._next.setdefault(actor, {})
        self.totals.lost += sequence - incarnations.get(incarnation, 0)
        incarnations[incarnation] = sequence + 1
        if len(incarnations) > INCARNATIONS_KEPT:
            del incarnations[min(incarnations)]
        return sequence + 1
