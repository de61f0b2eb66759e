"""What every fuzz has in common: broken pieces of input, one after the other, and what became of them."""

from __future__ import annotations

import random
import resource
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

Mutation = Callable[[random.Random, bytes], bytes]

MEMORY = 512 * 2**20
"""Bytes by which the process may grow."""


class Parser(NamedTuple):
    """A parser and what is thrown at it.

    Attributes:
        proper: valid pieces of input, which must be accepted.
        broken: makes a broken piece; all its choices are of the generator.
        parse: does with a piece what the service does that gets it.
        refusals: errors with which it may refuse a piece.
    """

    proper: Sequence[Any]
    broken: Callable[[random.Random], Any]
    parse: Callable[[Any], object]
    refusals: tuple[type[Exception], ...]


def file_parser(
    seeds: Sequence[bytes],
    mutations: Sequence[Mutation],
    path: Path,
    read: Callable[[Path], object],
    *refusals: type[Exception],
) -> Parser:
    """Return the parser of a file, which `read` reads at `path`.

    Args:
        seeds: contents of valid files.
        mutations: each makes a broken content of a valid one; one that is more important may come twice.
        path: where broken contents are written, in a folder of the fuzz's own.
        read: reads the file.
        refusals: errors with which it may be refused.
    """

    def parse(content: bytes) -> object:
        path.write_bytes(content)
        return read(path)

    def broken(chance: random.Random) -> bytes:
        return chance.choice(mutations)(chance, chance.choice(seeds))

    return Parser(seeds, broken, parse, refusals)


@dataclass
class Outcome:
    """What became of the pieces.

    Attributes:
        refused: how many, by reason or class of the error.
        accepted: how many were proper.
        holes: how many had another effect, by that effect.
        examples: the number of the first piece of each effect, and its traceback.
        slowest: seconds for one piece.
        growth: bytes by which the process grew.
    """

    refused: Counter[str] = field(default_factory=Counter)
    accepted: int = 0
    holes: Counter[str] = field(default_factory=Counter)
    examples: dict[str, tuple[int, str]] = field(default_factory=dict)
    slowest: float = 0.0
    growth: int = 0

    def add_hole(self, effect: str, number: int, trace: str = "") -> None:
        """Count a piece that had an effect which none may have."""
        self.holes[effect] += 1
        self.examples.setdefault(effect, (number, trace))


def throw(
    parser: Parser, numbers: Sequence[int], seed: int, begin: Callable[[int], None] = lambda number: None
) -> Outcome:
    """Throw broken pieces at a parser, after the proper ones.

    Args:
        parser: the parser.
        numbers: of the pieces; seed and number make the same piece again.
        seed: of the choices.
        begin: called before each piece.
    """
    for piece in parser.proper:
        parser.parse(piece)
    outcome, before = Outcome(), _peak_memory()
    for number in numbers:
        begin(number)
        piece = parser.broken(random.Random(f"{seed} {number}"))
        _throw_one(parser, piece, number, outcome)
        growth = _peak_memory() - before
        if growth > MEMORY and outcome.growth <= MEMORY:
            outcome.add_hole("takes too much memory", number)
        outcome.growth = growth
    return outcome


def _throw_one(parser: Parser, piece: object, number: int, outcome: Outcome) -> None:
    began = time.monotonic()
    try:
        parser.parse(piece)
        outcome.accepted += 1
    except parser.refusals as error:
        if len(str(error).splitlines()) != 1:
            outcome.add_hole(f"{type(error).__name__} is not one line", number, str(error))
        outcome.refused[getattr(error, "reason", type(error).__name__)] += 1
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        effect = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}"
        outcome.add_hole(effect, number, traceback.format_exc())
    outcome.slowest = max(outcome.slowest, time.monotonic() - began)


def _peak_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
