"""Which chunks the learner has: the next sequence of each (actor, incarnation). No network, no threads.

An entry may only be forgotten when no chunk of its incarnation can arrive any more: otherwise its chunks
would count as lost and could be stored again. Senders may lie about their incarnations, so the number itself
says nothing about that. An incarnation is living until it was unheard for `LIVING_SECONDS`. A full ledger
forgets the one unheard for longest, and refuses a new one while all are living. Each actor has a bound of its
own, so that nobody can fill the ledger under a single name.

For what was forgotten the ledger keeps a bound: an unknown incarnation that began before a forgotten one is
refused. So no chunk of a forgotten incarnation is stored a second time.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

from athrl_protocol.errors import InvalidMessage
from athrl_protocol.messages.chunk import Chunk
from athrl_protocol.messages.keys import CLOCK_DIFFERENCE_SECONDS, check_incarnation

# Incarnations of one actor that are kept: it would have to be restarted every 20 s all day to need more.
INCARNATIONS_KEPT = 4_096
# Incarnations of all actors that are kept: about 10 MB, in a checkpoint 6 MB at most with the longest names.
LARGEST_LEDGER = 32_768
# Without a chunk for so long an incarnation may be forgotten. Not shorter than the clock of an actor may be
# ahead: so a forgotten incarnation is never one from the future, and later ones are not refused with it.
LIVING_SECONDS = CLOCK_DIFFERENCE_SECONDS
# No incarnation makes so many chunks in years. It keeps the count of lost ones, which senders may make up, an
# integer of 64 bits for as many incarnations as are admitted in months.
END_OF_SEQUENCES = 2**40
FORGOTTEN = "*"  # no actor has this name


@dataclass(frozen=True)
class Known:
    """The chunk was taken in before, as everything below `next_sequence`."""

    next_sequence: int


@dataclass(frozen=True)
class Gap:
    """Earlier chunks are missing and the actor still holds them, from `expected_sequence` on."""

    expected_sequence: int


@dataclass(frozen=True)
class New:
    """The chunk is the next one; `lost` chunks before it are no longer held by the actor."""

    lost: int


@dataclass
class Totals:
    """Outcomes of all chunks of the run; their sum is all sequences below the ledger's next ones.

    Attributes:
        stored: chunks that were taken in.
        transitions: valid steps in them.
        refused: chunks that did not fit the run, which settles them.
        lost: chunks that were not taken in and that their actor does not hold any more.
    """

    stored: int = 0
    transitions: int = 0
    refused: int = 0
    lost: int = 0


@dataclass
class _Incarnation:
    """What is known of one incarnation."""

    next_sequence: int
    heard_at: float


@dataclass
class _Actor:
    """What is known of the incarnations of one name."""

    incarnations: OrderedDict[int, _Incarnation] = field(default_factory=OrderedDict)  # newest heard last
    forgotten_until: int = 0  # unknown incarnations up to this one may have been forgotten


class Ledger:
    """Decides whether a chunk is new, and records what was taken in.

    Args:
        saved: what `to_json` returned, from a checkpoint. All of it counts as just heard: nobody could be
            heard while there was no learner.
        totals: the totals as a dictionary at the same time.
        clock: seconds, for how long an incarnation was not heard.
        wall_clock: unix seconds, which incarnations are compared with.

    Raises:
        KeyError, ValueError: `saved` is not a ledger.
        TypeError: `totals` are not totals.
    """

    def __init__(
        self,
        saved: dict[str, Any] | None = None,
        totals: dict[str, int] | None = None,
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
    ) -> None:
        self.totals = Totals(**(totals or {}))
        self._clock = clock
        self._wall_clock = wall_clock
        self._actors: dict[str, _Actor] = {}
        self._order: OrderedDict[tuple[str, int], None] = OrderedDict()  # all incarnations, newest heard last
        self._forgotten_until = 0  # the same as an actor's, of names that are forgotten
        now = clock()
        for name, values in (saved or {}).items():
            if name == FORGOTTEN:
                continue
            actor = self._actors[name] = _Actor()
            for number, following in values.items():
                actor.incarnations[int(number)] = _Incarnation(int(following), now)
                self._order[name, int(number)] = None
        for name, until in (saved or {}).get(FORGOTTEN, {}).items():
            if name == FORGOTTEN:
                self._forgotten_until = int(until)
            else:
                self._actors[name].forgotten_until = int(until)

    def to_json(self) -> dict[str, dict[str, int]]:
        """Return actor -> incarnation -> next sequence, for a checkpoint.

        If incarnations were forgotten, `*` has for each actor, and as `*` for those that are not listed, the
        newest incarnation that may be among them.
        """
        saved = {
            name: {str(number): known.next_sequence for number, known in actor.incarnations.items()}
            for name, actor in self._actors.items()
        }
        forgotten = {name: actor.forgotten_until for name, actor in self._actors.items()}
        forgotten[FORGOTTEN] = self._forgotten_until
        forgotten = {name: until for name, until in forgotten.items() if until}
        return saved | ({FORGOTTEN: forgotten} if forgotten else {})

    def next_sequence(self, actor: str, incarnation: int) -> int:
        """Return the first sequence that was not taken in."""
        known = self._find(actor, incarnation)
        return 0 if known is None else known.next_sequence

    def hear(self, chunk: Chunk) -> Known | Gap | New:
        """Note that a chunk has arrived from its sender, and classify it.

        Raises:
            InvalidMessage: as `classify`; or its incarnation is from the future, may have been forgotten, or
                is one more than the ledger can keep. Names the actor.
        """
        known = self._find(chunk.actor, chunk.incarnation)
        if known is None:
            self._require_admissible(chunk)
        else:
            known.heard_at = self._clock()
            self._actors[chunk.actor].incarnations.move_to_end(chunk.incarnation)
            self._order.move_to_end((chunk.actor, chunk.incarnation))
        return self.classify(chunk)

    def classify(self, chunk: Chunk) -> Known | Gap | New:
        """Return whether a chunk is known, new, or comes after a gap.

        A learner that resumed an older checkpoint misses chunks that it had acknowledged. Their actor has
        dropped them, as `oldest_held` shows: they are lost, and later chunks are new.

        Raises:
            InvalidMessage: its sequence is too large; or, according to the chunk, its actor does not hold it.
        """
        if chunk.sequence >= END_OF_SEQUENCES:
            raise InvalidMessage(
                "value",
                f"chunk of actor {chunk.actor!r}: sequence is {chunk.sequence}, should be below "
                f"{END_OF_SEQUENCES}",
            )
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
        """Record that a chunk was taken in; return the next sequence. Missing ones before it are lost."""
        self.totals.stored += 1
        self.totals.transitions += chunk.length
        return self._settle(chunk.actor, chunk.incarnation, chunk.sequence)

    def refuse(self, actor: str, incarnation: int, sequence: int) -> int:
        """Record that a chunk was refused permanently; return the next sequence."""
        self.totals.refused += 1
        return self._settle(actor, incarnation, sequence)

    def totals_to_json(self) -> dict[str, int]:
        """Return the totals, for a checkpoint."""
        return asdict(self.totals)

    def _find(self, actor: str, incarnation: int) -> _Incarnation | None:
        of_actor = self._actors.get(actor)
        return None if of_actor is None else of_actor.incarnations.get(incarnation)

    def _require_admissible(self, chunk: Chunk) -> None:
        """Refuse an unknown incarnation that cannot be new, or for which no place can be made."""
        name = chunk.actor
        check_incarnation(f"chunk of actor {name!r}", chunk.incarnation, self._wall_clock())
        actor = self._actors.get(name)
        if chunk.incarnation <= (self._forgotten_until if actor is None else actor.forgotten_until):
            raise InvalidMessage(
                "incarnation",
                f"chunk of actor {name!r}: incarnation {chunk.incarnation} may be one that was forgotten "
                f"after {LIVING_SECONDS:.0f} s without a chunk: restart the actor",
            )
        oldest = self._to_forget(name)
        if oldest is None:
            return
        whose, number = oldest
        if self._unheard_seconds(whose, number) < LIVING_SECONDS:
            full = f"{name!r} has" if whose == name else "the actors together have"
            most = INCARNATIONS_KEPT if whose == name else LARGEST_LEDGER
            raise InvalidMessage(
                "incarnation",
                f"chunk of actor {name!r}: {full} {most} incarnations that were heard within "
                f"{LIVING_SECONDS:.0f} s, there is no place for {chunk.incarnation}",
            )

    def _to_forget(self, name: str) -> tuple[str, int] | None:
        """Return the incarnation that makes room for a new one of an actor; None if there is room."""
        actor = self._actors.get(name)
        if actor is not None and len(actor.incarnations) >= INCARNATIONS_KEPT:
            return name, next(iter(actor.incarnations))
        return next(iter(self._order)) if len(self._order) >= LARGEST_LEDGER else None

    def _unheard_seconds(self, actor: str, incarnation: int) -> float:
        return self._clock() - self._actors[actor].incarnations[incarnation].heard_at

    def _settle(self, actor: str, incarnation: int, sequence: int) -> int:
        known = self._find(actor, incarnation) or self._begin(actor, incarnation)
        self.totals.lost += sequence - known.next_sequence
        known.next_sequence = sequence + 1
        return sequence + 1

    def _begin(self, name: str, incarnation: int) -> _Incarnation:
        oldest = self._to_forget(name)
        if oldest is not None:
            self._forget(*oldest)
        known = _Incarnation(0, self._clock())
        actor = self._actors.setdefault(name, _Actor(forgotten_until=self._forgotten_until))
        actor.incarnations[incarnation] = known
        self._order[name, incarnation] = None
        return known

    def _forget(self, name: str, incarnation: int) -> None:
        actor = self._actors[name]
        del actor.incarnations[incarnation], self._order[name, incarnation]
        # Earlier releases admitted incarnations from the far future.
        actor.forgotten_until = max(actor.forgotten_until, min(incarnation, int(self._wall_clock() * 1e9)))
        if not actor.incarnations:
            self._forgotten_until = max(self._forgotten_until, actor.forgotten_until)
            del self._actors[name]
