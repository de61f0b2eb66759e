"""How a service is asked to stop: the first signal drains it, a second one ends it at once.

A service that `athrl train` started also has a pipe of its parent as standard input. When the parent goes,
however it goes, the pipe ends and the service drains as after a first signal, but not for ever.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM)
LIFELINE = "ATHRL_LIFELINE"
"""Environment variable that tells a service that its standard input is its parent's lifeline."""

FAREWELL_SECONDS = 10.0
"""How long a command that is done may take to leave."""

ORPHAN_SECONDS = 30.0
"""How long a service without its parent may take to drain."""


@contextmanager
def stop_on_signal(before_exit: Callable[[], None] | None = None) -> Iterator[threading.Event]:
    """Yield an event that the first SIGINT or SIGTERM sets; the second one ends the process at once.

    `before_exit` is called in between; it must not wait for anything.

    The signals are read from a pipe by a thread of their own (`signal.set_wakeup_fd`): setting an event in a
    signal handler can deadlock with the main thread waiting for that event, and a handler is not run at all
    while the main thread is inside a long call.
    """
    stop = threading.Event()
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    # The pipe before the handlers, so that none of them swallows a signal which nobody reads.
    earlier_writer = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    earlier = {number: signal.signal(number, _ignore) for number in SIGNALS}
    threading.Thread(
        target=_read_signals, args=(reader, stop, before_exit), name="signals", daemon=True
    ).start()
    if os.environ.pop(LIFELINE, None):
        threading.Thread(target=_follow_parent, args=(stop,), name="lifeline", daemon=True).start()
    try:
        yield stop
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(earlier_writer)
        os.close(writer)


def leave(code: int) -> NoReturn:
    """Exit with this code; for the end of a command, when nothing is left to be done.

    Python waits for its threads on the way out. One that never comes to its end, such as one in which an
    abandoned environment runs, holds the process up for `FAREWELL_SECONDS` at most.
    """
    end = threading.Timer(FAREWELL_SECONDS, os._exit, (code,))
    end.daemon = True
    end.start()
    sys.exit(code)


def _ignore(number: int, frame: object) -> None:
    """Let the thread that reads the pipe deal with the signal."""


def _read_signals(reader: int, stop: threading.Event, before_exit: Callable[[], None] | None) -> None:
    """Set `stop` on the first signal and end the process on the second; return when the pipe is closed."""
    with os.fdopen(reader, "rb", buffering=0) as numbers:
        while number := numbers.read(1):
            if number[0] not in SIGNALS:
                continue
            if stop.is_set():
                if before_exit is not None:
                    before_exit()
                os._exit(128 + number[0])
            stop.set()


def _follow_parent(stop: threading.Event) -> None:
    """Drain when the parent's end of standard input is closed, and end the whole process group in the end."""
    while os.read(0, 4096):
        pass
    stop.set()
    time.sleep(ORPHAN_SECONDS)
    os.killpg(os.getpgrp(), signal.SIGKILL)
