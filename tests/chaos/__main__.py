"""`python -m tests.chaos`: one storm, from its seed to its report."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from rich.console import Console

import tests.chaos
from tests.chaos.disk import Disk
from tests.chaos.report import draw, reckon
from tests.chaos.run import LONG_MINUTES, lay_out
from tests.chaos.storm import storm


def main() -> int:
    """Return the exit code."""
    arguments = _arguments()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends in order, as Ctrl-C does
    began = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - began:6.1f} s  {text}", flush=True)

    with ExitStack() as stack:
        if arguments.folder is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="athrl-storm-")))
        else:
            folder = arguments.folder
            folder.mkdir(parents=True)
        disk = stack.enter_context(Disk(folder / "storm" / "disk", kept=arguments.folder is not None))
        if not disk.permitted:
            say("no file system may be mounted here: the disk does not get full in this storm")
        run = lay_out(folder / "storm", arguments.actors, long=arguments.minutes >= LONG_MINUTES)
        seen = storm(run, disk, arguments.seed, 60.0 * arguments.minutes, say)
        say("reckoning")
        report = {"seed": arguments.seed, "minutes": arguments.minutes, **reckon(run, seen)}
    draw(report, Console(width=110))
    print(json.dumps(report))
    return 1 if report["failures"] else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=tests.chaos.__doc__)
    parser.add_argument("--seed", type=int, default=1, help="of the faults")
    parser.add_argument("--minutes", type=float, default=30.0, help="from when everybody works")
    parser.add_argument("--actors", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="a new one, which is kept; else a temporary one")
    return parser.parse_args()


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
