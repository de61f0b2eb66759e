"""Processes of a measurement, in a rack or beside the learner, and what they have cost."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

PATIENCE = 300.0
"""For a process to start: sixteen that import at once share two cores."""

_ATHRL = [sys.executable, "-c", "from athrl.command import main; main()"]
_MIB = 2**20


@dataclass(frozen=True)
class Reading:
    """What a process has cost so far: seconds of a core, and resident MiB."""

    cpu: float
    mebibytes: float


def reading(process: subprocess.Popen[bytes]) -> Reading:
    """Return what a running process has cost."""
    seen = psutil.Process(process.pid)
    times = seen.cpu_times()
    return Reading(times.user + times.system, seen.memory_info().rss / _MIB)


@contextmanager
def athrl(words: Sequence[str], log: Path, within: Sequence[str] = ()) -> Iterator[subprocess.Popen[bytes]]:
    """Run a command of athrl, whose output goes to `log`; it is ended with the block.

    It is in a session of its own: Linux shares cores between sessions first, and one with sixteen actors
    would leave the learner and the lines a sixteenth of a share.
    """
    with log.open("wb") as output:
        process = subprocess.Popen(
            [*within, *_ATHRL, *words], stdout=output, stderr=output, start_new_session=True
        )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(60)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(60)


@contextmanager
def router(
    listen: str, connect: str, run: str, log: Path, within: Sequence[str] = ()
) -> Iterator[subprocess.Popen[bytes]]:
    """Run `athrl router`; it listens when the block begins."""
    words = ["router", "--listen", listen, "--connect", connect, "--run", run]
    with athrl(words, log, within) as process:
        await_said(process, log, "router for run")
        yield process


def await_said(process: subprocess.Popen[bytes], log: Path, words: str) -> None:
    """Wait until a process has written something; end this one when it does not."""
    deadline = time.monotonic() + PATIENCE
    while words not in log.read_text():
        if process.poll() is not None or time.monotonic() > deadline:
            sys.exit(f"no {words!r} within {PATIENCE:.0f} s from {process.args}:\n{log.read_text()[-2000:]}")
        time.sleep(0.1)
