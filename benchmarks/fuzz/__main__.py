"""Throw broken input at a parser: each piece must be refused with our own error, or be proper all the same.

    python -m benchmarks.fuzz                                  a million messages at the decoders
    python -m benchmarks.fuzz --short                          as many as the tests throw
    python -m benchmarks.fuzz --parser run-file --count 100000
    python -m benchmarks.fuzz --parser run-file --only 4711    one piece again

A process of its own parses, so that one that hangs, dies, or takes all memory is noticed too. Exit code 1 if
any piece had another effect; the first of each effect is shown. The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.fuzz.frame import Outcome
from benchmarks.fuzz.parsers import PARSERS
from benchmarks.fuzz.watch import watched

LONG_MESSAGES, SHORT_MESSAGES, FILES = 1_000_000, 25_000, 100_000
"""How many pieces a run throws."""


def main() -> None:
    """Run from the command line."""
    arguments = _arguments()
    count = arguments.count or (LONG_MESSAGES if arguments.parser == "messages" else FILES)
    numbers = range(count) if arguments.only is None else [arguments.only]
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        outcome = watched(arguments.parser, numbers, arguments.seed, Path(folder))
    for effect, (number, trace) in outcome.examples.items():
        print(f"{effect}, first by number {number}:\n{trace}", file=sys.stderr)
    seconds = time.monotonic() - began
    reasons = ", ".join(f"{reason} {times:,}" for reason, times in outcome.refused.most_common()) or "none"
    what = f"{len(numbers):,} {arguments.parser}"
    print(f"{what} in {seconds:.0f} s: refused {reasons}; proper {outcome.accepted:,}")
    print(json.dumps(_report(arguments.parser, arguments.seed, len(numbers), outcome, seconds)))
    sys.exit(1 if outcome.holes else 0)


def _report(name: str, seed: int, count: int, outcome: Outcome, seconds: float) -> dict[str, object]:
    return {
        "parser": name,
        "count": count,
        "seed": seed,
        "refused": outcome.refused.total(),
        "proper": outcome.accepted,
        "holes": dict(outcome.holes),
        "slowest_seconds": round(outcome.slowest, 3),
        "growth_mebibytes": round(outcome.growth / 2**20, 1),
        "seconds": round(seconds, 1),
    }


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--parser", choices=PARSERS, default="messages")
    how_many = parser.add_mutually_exclusive_group()
    how_many.add_argument("--count", type=int, help="pieces; by default a million messages, 100,000 files")
    how_many.add_argument(
        "--short", action="store_const", dest="count", const=SHORT_MESSAGES, help="as the tests do"
    )
    how_many.add_argument("--only", type=int, metavar="NUMBER", help="the piece of this number alone")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


if __name__ == "__main__":
    main()
