"""The chunks that an uploader holds, and which of them is sent next. No network, no threads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Reason = Literal["invalid", "finished", "closed", "bound"]
"""Why a chunk was given up: the learner refused it permanently; the run was over; the uploader was closed
while it was held; it was never submitted because the bound was reached."""
REASONS: tuple[Reason, ...] = ("invalid", "finished", "closed", "bound")


@dataclass(frozen=True)
class UploadStatistics:
    """Counts of chunks; `produced` is the sum of acknowledged, given up and waiting.

    Attributes:
        produced: made by the actor: submitted, or given up because the bound was reached.
        acknowledged: stored by the learner.
        resent: sent again, after silence or a rewind.
        turned_away: sent again because the learner was busy; counted each time.
        given_up: given up for any reason.
        waiting: held, not yet acknowledged.
        given_up_by_reason: the same by reason, each of `REASONS`.
    """

    produced: int
    acknowledged: int
    resent: int
    turned_away: int
    given_up: int
    waiting: int
    given_up_by_reason: dict[str, int]


class UploadWindow:
    """Encoded chunks from the oldest unacknowledged one to the newest.

    `reserve` gives a chunk its sequence; it can be taken once `put` has added it.
    """

    def __init__(self) -> None:
        self._held: dict[int, bytes | None] = {}  # by sequence, in order; None until `put`
        self._added = 0
        self._next = 0
        self._sent_up_to = 0
        self._acknowledged = 0
        self._resent = 0
        self._turned_away_up_to = 0
        self._turned_away = 0
        self._given_up: dict[str, int] = dict.fromkeys(REASONS, 0)

    def __len__(self) -> int:
        return len(self._held)

    @property
    def is_empty(self) -> bool:
        """Whether every chunk is settled."""
        return not self._held

    @property
    def has_unsent(self) -> bool:
        """Whether a chunk, reserved or put, was not taken since the last rewind."""
        return next(reversed(self._held), -1) >= self._next

    @property
    def unsent(self) -> int:
        """How many chunks were not taken since the last rewind, including those given up."""
        return self._added - self._next

    @property
    def has_to_resend(self) -> bool:
        """Whether the next chunk was already sent before."""
        return self._next < self._sent_up_to

    def reserve(self) -> int:
        """Reserve a place for the next chunk; return its sequence."""
        self._held[self._added] = None
        self._added += 1
        return self._added - 1

    def put(self, sequence: int, encoded: bytes) -> None:
        """Hold a chunk whose place was reserved, unless it has been given up."""
        if sequence in self._held:
            self._held[sequence] = encoded

    def take(self, largest: int | None = None) -> tuple[int, int, bytes] | None:
        """Return (sequence, oldest held sequence, encoded chunk) of the next chunk, or None.

        None also if it has more than `largest` bytes.
        """
        while self._next < self._added and self._next not in self._held:
            self._next += 1
        sequence, encoded = self._next, self._held.get(self._next)
        if encoded is None or (largest is not None and len(encoded) > largest):
            return None
        self._next += 1
        if sequence < self._turned_away_up_to:
            self._turned_away += 1
        elif sequence < self._sent_up_to:
            self._resent += 1
        self._sent_up_to = max(self._sent_up_to, self._next)
        return sequence, next(iter(self._held)), encoded

    def acknowledge(self, next_sequence: int) -> int:
        """Drop all sent chunks below `next_sequence` and return how many."""
        settled = [held for held in self._held if held < min(next_sequence, self._sent_up_to)]
        for sequence in settled:
            del self._held[sequence]
        self._acknowledged += len(settled)
        self._next = max(self._next, min(next_sequence, self._sent_up_to))
        return len(settled)

    def rewind(self, turned_away: bool = False) -> None:
        """Continue with the oldest held chunk; `turned_away` if the learner was busy."""
        self._next = next(iter(self._held), self._added)
        self._turned_away_up_to = self._sent_up_to if turned_away else 0

    def rewind_to(self, sequence: int) -> None:
        """Continue with `sequence`, or with the oldest held chunk if that is newer."""
        self.rewind()
        self._next = max(self._next, min(sequence, self._sent_up_to))

    def give_up(self, sequence: int) -> None:
        """Drop one chunk that the learner will never accept."""
        if sequence in self._held:
            del self._held[sequence]
            self._given_up["invalid"] += 1

    def give_up_all(self, reason: Reason) -> None:
        """Drop all held chunks."""
        self._given_up[reason] += len(self._held)
        self._held.clear()

    def leave_out(self, chunks: int) -> None:
        """Count chunks that were not submitted because the bound was reached; they get no sequence."""
        self._given_up["bound"] += chunks

    def statistics(self) -> UploadStatistics:
        """Return the counts."""
        return UploadStatistics(
            produced=self._added + self._given_up["bound"],
            acknowledged=self._acknowledged,
            resent=self._resent,
            turned_away=self._turned_away,
            given_up=sum(self._given_up.values()),
            waiting=len(self._held),
            given_up_by_reason=dict(self._given_up),
        )
