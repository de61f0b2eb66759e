"""Parses in another process, which may hang or die without harm."""

from __future__ import annotations

import logging
import multiprocessing
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path

from benchmarks.fuzz.frame import Outcome, throw
from benchmarks.fuzz.parsers import load

LONGEST = 10.0
"""Seconds for one piece."""
START = 120.0
"""Seconds until the first piece: the parser is imported and reads its proper files."""


def watched(name: str, numbers: Sequence[int], seed: int, folder: Path) -> Outcome:
    """Throw the pieces in another process, and end it if one piece takes too long."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    current: Synchronized[int] = context.Value("q", -1)
    process = context.Process(target=_child, args=(name, numbers, seed, folder, sender, current))
    process.start()
    sender.close()
    seen, since = -1, time.monotonic()
    effect = "kills its process"
    while process.is_alive() and not receiver.poll(0.2):
        if (now := current.value) != seen:
            seen, since = now, time.monotonic()
        elif time.monotonic() - since > (LONGEST if seen >= 0 else START):
            effect = "hangs"
            process.kill()
            break
    try:
        outcome: Outcome = receiver.recv()
    except EOFError:
        outcome = Outcome()
        outcome.add_hole(effect, current.value)
    process.join()
    return outcome


def _child(
    name: str, numbers: Sequence[int], seed: int, folder: Path, sender: Connection, current: Synchronized[int]
) -> None:
    def begin(number: int) -> None:
        current.value = number

    logging.disable()  # of what is refused, thousands of lines
    sender.send(throw(load(name, folder), numbers, seed, begin))
