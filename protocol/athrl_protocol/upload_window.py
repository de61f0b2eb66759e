"""The chunks that an uploader still holds, and which of them goes next. No network, no threads."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class UploadStatistics:
    """Counts of chunks; `produced` is the sum of acknowledged, given up and waiting.

    Attributes:
        produced: taken from the actor.
        acknowledged: stored by the learner.
        resent: sent once more, after silence, "busy" or a rewind.
        given_up: refused as invalid, or left when the run was over or the uploader was closed.
        waiting: held, not yet acknowledged.
    """

    produced: int
    acknowledged: int
    resent: int
    given_up: int
    waiting: int


class UploadWindow:
    """Encoded chunks from the oldest that is not acknowledged to the newest, at most `capacity`."""

    def __init__(self, capacity: int) -> None:
        if capacity < 1:
            raise ValueError(f"capacity is {capacity}, should be at least 1")
        self._capacity = capacity
        self._held: dict[int, bytes] = {}  # by sequence, in order
        self._produced = 0
        self._next = 0
        self._sent_up_to = 0
        self._acknowledged = 0
        self._resent = 0
        self._given_up = 0

    def __len__(self) -> int:
        return len(self._held)

    @property
    def is_full(self) -> bool:
        """Whether no further chunk fits."""
        return len(self) >= self._capacity

    @property
    def is_empty(self) -> bool:
        """Whether every chunk is settled."""
        return not self._held

    @property
    def has_unsent(self) -> bool:
        """Whether `take` would return a chunk."""
        return any(sequence >= self._next for sequence in reversed(self._held))

    @property
    def next_sequence(self) -> int:
        """Sequence of the next chunk to be added."""
        return self._produced

    def add(self, encoded: bytes) -> None:
        """Hold a chunk that was encoded with `next_sequence`."""
        self._held[self._produced] = encoded
        self._produced += 1

    def take(self) -> tuple[int, int, bytes] | None:
        """Return (sequence, oldest held sequence, encoded chunk) of what goes next, or None."""
        while self._next < self._produced and self._next not in self._held:
            self._next += 1
        if self._next >= self._produced:
            return None
        sequence = self._next
        self._next += 1
        if sequence < self._sent_up_to:
            self._resent += 1
        self._sent_up_to = max(self._sent_up_to, self._next)
        return sequence, next(iter(self._held)), self._held[sequence]

    def acknowledge(self, next_sequence: int) -> None:
        """Drop all chunks below `next_sequence`; what was never sent stays."""
        for sequence in [held for held in self._held if held < min(next_sequence, self._sent_up_to)]:
            del self._held[sequence]
            self._acknowledged += 1
        self._next = max(self._next, min(next_sequence, self._sent_up_to))

    def rewind(self) -> None:
        """Begin again with the oldest held chunk."""
        self._next = next(iter(self._held), self._produced)

    def rewind_to(self, sequence: int) -> None:
        """Begin again with `sequence`, or with the oldest held chunk if that is newer."""
        self.rewind()
        self._next = max(self._next, min(sequence, self._sent_up_to))

    def give_up(self, sequence: int) -> None:
        """Drop one chunk that the learner will never take."""
        if self._held.pop(sequence, None) is not None:
            self._given_up += 1

    def give_up_all(self) -> None:
        """Drop everything that is held."""
        self._given_up += len(self._held)
        self._held.clear()

    def statistics(self) -> UploadStatistics:
        """Return the counts."""
        return UploadStatistics(
            self._produced, self._acknowledged, self._resent, self._given_up, len(self._held)
        )
