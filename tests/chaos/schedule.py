"""The schedule of faults: kinds, order and durations, all determined by the seed."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

TWO_AT_ONCE = 0.25
"""Probability that two faults begin together."""
NO_RECOVERY = 0.2
"""Probability that the next faults begin before the services have recovered."""
LEASE_SECONDS = 5.0
"""Zenoh's lease, after which a silent peer is given up: pauses and outages are shorter or longer."""


class Kind(StrEnum):
    """Kinds of faults."""

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
    ROUTER_KILLED = "router killed"
    ROUTER_PAUSED = "router paused"
    ROUTER_STOPPED = "router stopped"
    LINK_CUT = "connection cut"
    LINK_SILENT = "connection silent both ways"
    LINK_SILENT_OUT = "connection silent towards the learner"
    LINK_SILENT_IN = "connection silent from the learner"
    LINK_SLOW = "connection slow"
    DISK_FULL = "disk full"
    DISK_FULL_LEARNER_KILLED = "disk full, learner killed"
    FLOOD = "flood of malformed messages"
    STRANGERS = "connections of strangers"
    FORGERY = "chunks forged under an actor's name"


FAMILIES: dict[str, tuple[Kind, ...]] = {
    "learner": (Kind.LEARNER_KILLED, Kind.LEARNER_PAUSED, Kind.LEARNER_STOPPED, Kind.CHECKPOINT_DAMAGED),
    "actor": (Kind.ACTOR_KILLED, Kind.ACTOR_PAUSED, Kind.ACTOR_STOPPED),
    "evaluator": (Kind.EVALUATOR_KILLED, Kind.EVALUATOR_PAUSED, Kind.EVALUATOR_STOPPED),
    "router": (Kind.ROUTER_KILLED, Kind.ROUTER_PAUSED, Kind.ROUTER_STOPPED),
    "connection": (
        Kind.LINK_CUT,
        Kind.LINK_SILENT,
        Kind.LINK_SILENT_OUT,
        Kind.LINK_SILENT_IN,
        Kind.LINK_SLOW,
    ),
    "disk": (Kind.DISK_FULL, Kind.DISK_FULL_LEARNER_KILLED),
    "intruder": (Kind.FLOOD, Kind.STRANGERS, Kind.FORGERY),
}
"""Families of faults by target. One kind of each family comes first, so that a short run has them all."""

_RESTARTED = {
    Kind.LEARNER_KILLED,
    Kind.LEARNER_STOPPED,
    Kind.CHECKPOINT_DAMAGED,
    Kind.ACTOR_KILLED,
    Kind.ACTOR_STOPPED,
    Kind.EVALUATOR_KILLED,
    Kind.EVALUATOR_STOPPED,
    Kind.ROUTER_KILLED,
    Kind.ROUTER_STOPPED,
}


_FAMILY_OF = {kind: family for family, members in FAMILIES.items() for kind in members}


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes:
        kind: kind of the fault.
        target: affected service, or the one whose connection is affected; the learner for intruders and disk.
        seconds: duration, or for a killed service the time until its restart.
        seed: seed of the other random choices.
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
        calm: seconds from the recovery to the next faults.
        recovers_first: whether the services recover before the next faults.
    """

    faults: tuple[Fault, ...]
    calm: float
    recovers_first: bool


def schedule(
    seed: int, targets: dict[str, list[str]], kinds: frozenset[Kind], *, longest_pause: float
) -> Iterator[Group]:
    """Yield groups of faults without end: one of each family, then every kind before any comes again.

    Args:
        seed: the same one gives the same faults.
        targets: family -> names of its possible targets.
        kinds: possible kinds.
        longest_pause: seconds of the longest pauses and outages.
    """
    chance = random.Random(seed)
    possible = [[kind for kind in family if kind in kinds] for family in FAMILIES.values()]
    deck = [chance.choice(family) for family in possible if family]
    chance.shuffle(deck)

    def next_fault() -> Fault:
        if not deck:
            deck.extend(chance.sample(sorted(kinds), len(kinds)))
        kind = deck.pop()
        target = chance.choice(targets[_FAMILY_OF[kind]])
        return Fault(kind, target, _seconds(chance, kind, longest_pause), chance.getrandbits(32))

    while True:
        faults = [next_fault()]
        if chance.random() < TWO_AT_ONCE:
            second = next_fault()
            if second.target != faults[0].target:
                faults.append(second)
            else:
                deck.append(second.kind)
        yield Group(tuple(faults), chance.uniform(0.5, 3.0), chance.random() >= NO_RECOVERY)


def complete(happened: set[Kind], kinds: frozenset[Kind], *, every: bool) -> bool:
    """Whether the required faults have occurred: every one of these kinds, or one of each family."""
    if every:
        return kinds <= happened
    return all(happened & set(family) for family in FAMILIES.values() if kinds & set(family))


def _seconds(chance: random.Random, kind: Kind, longest_pause: float) -> float:
    if kind in _RESTARTED:
        return chance.uniform(0.0, 3.0)
    if kind is Kind.LINK_CUT:
        return chance.uniform(0.0, 2.0)
    if kind in (*FAMILIES["intruder"], Kind.LINK_SLOW, *FAMILIES["disk"]):
        return chance.uniform(2.0, 5.0)
    if chance.random() < 0.5:
        return chance.uniform(0.5, LEASE_SECONDS - 1.5)
    return chance.uniform(LEASE_SECONDS + 1.0, longest_pause)
