"""`python -m tests.chaos`: one run with fault injection, from its seed to its report."""

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
from tests.chaos.fault_injection import inject_faults
from tests.chaos.report import draw, summarise
from tests.chaos.run import LONG_MINUTES, lay_out


def main() -> int:
    """Return the exit code."""
    arguments = _arguments()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends gracefully, as with Ctrl-C
    began = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - began:6.1f} s  {text}", flush=True)

    with ExitStack() as stack:
        if arguments.folder is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="athrl-chaos-")))
        else:
            folder = arguments.folder
            folder.mkdir(parents=True)
        disk = stack.enter_context(Disk(folder / "chaos" / "disk", kept=arguments.folder is not None))
        if not disk.permitted:
            say("no file system may be mounted here: the disk does not get full in this run")
        run = lay_out(folder / "chaos", arguments.actors, long=arguments.minutes >= LONG_MINUTES)
        seen = inject_faults(run, disk, arguments.seed, 60.0 * arguments.minutes, say)
        say("auditing the run")
        report = {"seed": arguments.seed, "minutes": arguments.minutes, **summarise(run, seen)}
    draw(report, Console(width=110))
    print(json.dumps(report))
    return 1 if report["failures"] else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=tests.chaos.__doc__)
    parser.add_argument("--seed", type=int, default=1, help="seed of the faults")
    parser.add_argument("--minutes", type=float, default=30.0, help="duration, after all services work")
    parser.add_argument("--actors", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="new folder, which is kept; by default a temporary one")
    return parser.parse_args()


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
