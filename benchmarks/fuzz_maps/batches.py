"""Drives on many maps in processes of their own, which may hang or die without harm."""

from __future__ import annotations

import faulthandler
import logging
import multiprocessing
import re
import signal
import time
import traceback
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

from athrl_driving.errors import DrivingError
from athrl_driving.kernels.index_checks import CHECKS_INDICES

from benchmarks.fuzz.frame import Outcome
from benchmarks.fuzz.maps import TOWN
from benchmarks.fuzz_maps.drive import drive_on
from benchmarks.fuzz_maps.made import made_map

LONGEST = 30.0 if CHECKS_INDICES else 5.0
"""Seconds of CPU for one map; kernels that check their indices are several times slower."""
_HANGS = 60.0
"""Seconds of any clock for one map, on a machine that does other things too."""
_START = 600.0
"""Seconds until a process says something: it may have to compile the kernels, or wait for one that does."""
_BATCH = 100
"""Maps for one process."""
_READY = "ready"

_NAMES = re.compile(r"'[^']*'|-?\d[\d.,e+-]*")
_UNFORESEEN = (AttributeError, IndexError, KeyError, TypeError, ValueError)
"""Python's errors that are converted to refusals although nobody thought of them."""


class Fate(NamedTuple):
    """What became of a map.

    Attributes:
        number: of the map.
        refused: why it was refused, without names and numbers; empty where it was not.
        hole: what happened that may not; empty where nothing did.
        trace: where that happened.
        seconds: of CPU.
    """

    number: int
    refused: str
    hole: str
    trace: str
    seconds: float


def drive_on_maps(numbers: Sequence[int], seed: int, jobs: int, folder: Path) -> Outcome:
    """Drive on the maps of these numbers in `jobs` processes at a time.

    Maps are written to `folder`; those that were refused or drove well are removed again.
    """
    batches = [numbers[first : first + _BATCH] for first in range(0, len(numbers), _BATCH)]
    outcome = Outcome()
    with ThreadPoolExecutor(jobs) as pool:
        for fates in pool.map(lambda batch: _fates(batch, seed, folder), batches):
            for fate in fates:
                _count(fate, outcome)
    return outcome


def _count(fate: Fate, outcome: Outcome) -> None:
    outcome.slowest = max(outcome.slowest, fate.seconds)
    if fate.hole:
        outcome.add_hole(fate.hole, fate.number, fate.trace)
    elif fate.refused:
        outcome.refused[fate.refused] += 1
    else:
        outcome.accepted += 1


def _fates(numbers: Sequence[int], seed: int, folder: Path) -> list[Fate]:
    """Drive on the maps of a batch; after one that ends its process, the others get another process."""
    fates: list[Fate] = []
    context = multiprocessing.get_context("spawn")
    while len(fates) < len(numbers):
        receiver, sender = context.Pipe(duplex=False)
        left = numbers[len(fates) :]
        process = context.Process(target=_child, args=(left, seed, folder, sender))
        process.start()
        sender.close()
        if _received(receiver, _START) != _READY:
            raise RuntimeError(f"a process {_end_of(process)} before its first map")
        while len(fates) < len(numbers):
            fate = _received(receiver, _HANGS)
            if fate is None:
                fates.append(Fate(numbers[len(fates)], "", _end_of(process), "", 0.0))
                break
            fates.append(fate)
        process.join(timeout=_HANGS)
    return fates


def _received(receiver: Connection, seconds: float) -> Any:
    """Return what a process sends within so many seconds, None if it does not or has ended."""
    try:
        return receiver.recv() if receiver.poll(seconds) else None
    except EOFError:
        return None


def _end_of(process: BaseProcess) -> str:
    """Return how a process ended that did not drive on all of its maps; one that still runs is ended."""
    process.join(timeout=1.0)
    if process.exitcode is None:
        process.kill()
        return "hangs"
    if process.exitcode < 0:
        return f"dies of {signal.Signals(-process.exitcode).name}"
    return f"exits with {process.exitcode}"


def _child(numbers: Sequence[int], seed: int, folder: Path, sender: Connection) -> None:
    """Send that it is ready when the kernels are there, then the fate of each map."""
    logging.disable()  # of what is left out
    faulthandler.enable()
    warnings.simplefilter("ignore")
    warnings.simplefilter("error", RuntimeWarning)  # of numbers that are none
    drive_on(TOWN, 8, 0)  # compiles the kernels or loads them, which counts for no map
    sender.send(_READY)
    for number in numbers:
        path = folder / f"{seed}-{number}.xodr"
        path.write_bytes(made_map(seed, number))
        fate = _fate(path, seed, number)
        if not fate.hole:
            path.unlink()
        sender.send(fate)


def _fault_of_refusal(error: DrivingError) -> str:
    """Return what is wrong with a refusal itself: more than a line, or no words of ours."""
    said, cause = str(error), error.__context__
    if len(said.splitlines()) != 1:
        return "a refusal is not one line"
    if type(cause) in _UNFORESEEN and str(cause) in said:
        return f"a refusal is {type(cause).__name__}: {cause}"
    return ""


def _fate(path: Path, seed: int, number: int) -> Fate:
    """Drive on a map and return what becomes of it."""
    chance, began = Random(f"{seed} {number} driving"), time.process_time()
    refused = hole = trace = ""
    try:
        drive_on(path, chance.randint(8, 20), chance.randrange(1000))
    except DrivingError as error:
        refused = _NAMES.sub("..", str(error).removeprefix(f"{path.name}: "))
        hole, trace = _fault_of_refusal(error), traceback.format_exc()
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        what = _NAMES.sub("..", str(error))
        hole = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {what}"
        trace = traceback.format_exc()
    seconds = time.process_time() - began
    if seconds > LONGEST and not hole:
        hole = f"takes more than {LONGEST:g} s"
    return Fate(number, refused, hole, trace, seconds)
