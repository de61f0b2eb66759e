"""Which faults come, in which order and how long: all of it follows from the seed."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

TWO_AT_ONCE = 0.25
"""Chance that two faults begin together."""
NO_MERCY = 0.2
"""Chance that the next faults come before everybody has recovered from these."""
LEASE_SECONDS = 5.0
"""After so long Zenoh gives a silent peer up: pauses and holes are shorter or longer than that."""


class Kind(StrEnum):
    """What can go wrong."""

    LEARNER_KILLED = "learner killed"
    LEARNER_PAUSED = "learner paused"
    LEARNER_STOPPED = "learner stopped"
    CHECKPOINT_DAMAGED = "learner killed, newest checkpoint damaged"
    ACTOR_KILLED = "actor killed"
    ACTOR_PAUSED = "actor paused"
    ACTOR_STOPPED = "actor stopped"
    EVALUATOR_KILLED = "evaluator killed"
    EVALUATOR_PAUSED = "evaluator paused"
    EVALUATOR_STOPPED = "evaluator stopped"
    LINK_CUT = "connection cut"
    LINK_SILENT = "connection silent both ways"
    LINK_SILENT_OUT = "connection silent towards the learner"
    LINK_SILENT_IN = "connection silent from the learner"
    LINK_SLOW = "connection slow"
    FLOOD = "flood of malformed messages"
    STRANGERS = "connections of strangers"


FIRST = (
    Kind.LEARNER_KILLED,
    Kind.CHECKPOINT_DAMAGED,
    Kind.ACTOR_KILLED,
    Kind.LINK_SILENT,
    Kind.FLOOD,
)
"""What comes first, in any order, so that also a short storm has it; from then on all kinds come alike."""

_RESTARTED = {
    Kind.LEARNER_KILLED,
    Kind.LEARNER_STOPPED,
    Kind.CHECKPOINT_DAMAGED,
    Kind.ACTOR_KILLED,
    Kind.ACTOR_STOPPED,
    Kind.EVALUATOR_KILLED,
    Kind.EVALUATOR_STOPPED,
}


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong.

    Attributes:
        kind: what.
        target: the service that it happens to, or whose connection; the learner for a flood.
        seconds: how long, or for what dies how long until it is started again.
        seed: of whatever else is left to chance.
    """

    kind: Kind
    target: str
    seconds: float
    seed: int


@dataclass(frozen=True)
class Group:
    """Faults that begin together.

    Attributes:
        faults: one or two, of different targets.
        calm: seconds after everybody has recovered, until the next faults.
        merciful: whether everybody may recover first.
    """

    faults: tuple[Fault, ...]
    calm: float
    merciful: bool


def schedule(seed: int, actors: list[str], evaluator: str, *, longest_pause: float) -> Iterator[Group]:
    """Yield groups of faults without end: `FIRST`, and then every kind before any comes again.

    Args:
        seed: the same one gives the same faults.
        actors: names of the actors.
        evaluator: name of the evaluator.
        longest_pause: seconds; of the long pauses and holes.
    """
    chance = random.Random(seed)
    deck = chance.sample(FIRST, len(FIRST))
    while True:
        faults = [_next_fault(chance, deck, actors, evaluator, longest_pause)]
        if chance.random() < TWO_AT_ONCE:
            second = _next_fault(chance, deck, actors, evaluator, longest_pause)
            if second.target != faults[0].target:
                faults.append(second)
            else:
                deck.append(second.kind)
        yield Group(tuple(faults), chance.uniform(0.5, 3.0), chance.random() >= NO_MERCY)


def _next_fault(
    chance: random.Random, deck: list[Kind], actors: list[str], evaluator: str, longest_pause: float
) -> Fault:
    if not deck:
        deck.extend(chance.sample(list(Kind), len(Kind)))
    kind = deck.pop()
    return Fault(
        kind,
        _target(chance, kind, actors, evaluator),
        _seconds(chance, kind, longest_pause),
        chance.getrandbits(32),
    )


def _target(chance: random.Random, kind: Kind, actors: list[str], evaluator: str) -> str:
    role = kind.split()[0]
    if role == "actor":
        return chance.choice(actors)
    if role == "evaluator":
        return evaluator
    if role == "connection":
        return chance.choice([*actors, *actors, evaluator])
    return "learner"


def _seconds(chance: random.Random, kind: Kind, longest_pause: float) -> float:
    if kind in _RESTARTED:
        return chance.uniform(0.0, 3.0)
    if kind is Kind.LINK_CUT:
        return chance.uniform(0.0, 2.0)
    if kind in (Kind.FLOOD, Kind.STRANGERS, Kind.LINK_SLOW):
        return chance.uniform(2.0, 5.0)
    if chance.random() < 0.5:
        return chance.uniform(0.5, LEASE_SECONDS - 1.5)
    return chance.uniform(LEASE_SECONDS + 1.0, longest_pause)
