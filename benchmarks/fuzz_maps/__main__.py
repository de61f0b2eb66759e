"""Drive for 20 seconds on each of many maps: generated ones, and damaged ones as people have them.

    python -m benchmarks.fuzz_maps                                10,000 maps
    python -m benchmarks.fuzz_maps --count 300 --seed 2 --jobs 2
    python -m benchmarks.fuzz_maps --only 4711                    one map again
    ATHRL_CHECK_INDICES=1 python -m benchmarks.fuzz_maps          with kernels that check their indices

A map drives or is refused in one line: no process dies or hangs, no speed or place is infinite or beyond
what cars do, no background vehicle leaves the lanes, and none takes five seconds of CPU. Exit code 1
otherwise; the first map of each effect is named, and all such maps are kept in `--keep`. The last line is one
JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path

from benchmarks.fuzz.frame import Outcome
from benchmarks.fuzz_maps.batches import drive_on_maps

MAPS = 10_000
_REASONS_SHOWN = 20


def main() -> None:
    """Run from the command line."""
    arguments = _arguments()
    numbers = range(arguments.count) if arguments.only is None else [arguments.only]
    arguments.keep.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    outcome = drive_on_maps(numbers, arguments.seed, arguments.jobs, arguments.keep)
    seconds = time.monotonic() - began
    for reason, times in outcome.refused.most_common(_REASONS_SHOWN):
        print(f"{times:6,} refused: {reason}")
    for effect, (number, trace) in outcome.examples.items():
        map_file = arguments.keep / f"{arguments.seed}-{number}.xodr"
        print(f"{outcome.holes[effect]:6,} {effect}; first {map_file}\n{trace}", file=sys.stderr)
    print(json.dumps(_report(arguments.seed, len(numbers), outcome, seconds)))
    sys.exit(1 if outcome.holes else 0)


def _report(seed: int, count: int, outcome: Outcome, seconds: float) -> dict[str, object]:
    return {
        "maps": count,
        "seed": seed,
        "drove": outcome.accepted,
        "refused": outcome.refused.total(),
        "holes": dict(outcome.holes),
        "slowest_cpu_seconds": round(outcome.slowest, 2),
        "seconds": round(seconds, 1),
    }


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    how_many = parser.add_mutually_exclusive_group()
    how_many.add_argument("--count", type=int, default=MAPS, help=f"maps; default: {MAPS:,}")
    how_many.add_argument("--only", type=int, metavar="NUMBER", help="the map of this number alone")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="processes")
    parser.add_argument(
        "--keep",
        type=Path,
        default=Path("fuzz-maps"),
        help="folder for the maps that fail; default: fuzz-maps",
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
