"""A service that follows its learner from machine to machine, and leaves when there is none for long.

A service that waits holds its machine. Under a scheduler the learner may wait for just that machine, so the
service ends with a code that says "try again later", and the scheduler may give the machine to the learner.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import typer
from athrl_protocol import LearnerNotFound
from athrl_protocol.announcements.address_file import read_address

from athrl.errors import say
from athrl.rendezvous.relay import Relay
from athrl.rendezvous.run_folder import folder_in

TRY_AGAIN = os.EX_TEMPFAIL
"""Exit code of a service that has no learner: 75, as of other programs whose service is away for now."""

SILENT_SECONDS = 300.0
"""For so long a learner that was there may be away; a first one is waited for as without a folder, 30 s."""

POLL_SECONDS = 0.2


def follow(
    connect: str,
    stop: threading.Event,
    serve: Callable[[str, threading.Event], object],
    silent_seconds: float = SILENT_SECONDS,
) -> None:
    """Call `serve` with an address, and the event that stops it.

    If `connect` names a run's folder, the address leads to the learner wherever the folder says it is.

    Raises:
        typer.Exit: with `TRY_AGAIN`, after one line: there is no learner, or none has been heard for long.
    """
    folder = folder_in(connect)
    if folder is None:
        serve(connect, stop)
        return
    with Relay(partial(read_address, folder)) as relay, _or_silence(stop, relay, silent_seconds) as over:
        try:
            serve(relay.address, over)
        except LearnerNotFound:
            raise _no_learner(folder) from None
        # The service has ended by itself if its run is finished, and then a silent learner is no wonder.
        silent = over.is_set() and not stop.is_set()
    if silent:
        raise _no_learner(folder, f", and has not answered for {silent_seconds:g} s")


@contextmanager
def _or_silence(stop: threading.Event, relay: Relay, most: float) -> Iterator[threading.Event]:
    """Yield an event that is set when `stop` is, and when the learner is silent for `most` seconds."""
    over, ended = threading.Event(), threading.Event()

    def watch() -> None:
        while not ended.is_set():
            if stop.wait(POLL_SECONDS) or relay.silent_seconds > most:
                over.set()
                return

    watcher = threading.Thread(target=watch, name="silence", daemon=True)
    watcher.start()
    try:
        yield over
    finally:
        ended.set()
        watcher.join()


def _no_learner(folder: Path, since: str = "") -> typer.Exit:
    address = read_address(folder)
    where = f"the learner of {folder} was last at {address}" if address else f"{folder} names no learner"
    say(f"{where}{since or ', and none answers'}; ending with {TRY_AGAIN}: try again later")
    return typer.Exit(TRY_AGAIN)
