"""How a service is asked to stop: the first signal drains it, a second one ends it at once.

Draining has a limit, which counts from the first signal until the process is gone: a disk that is stuck, a
session that does not close or an import on a busy machine holds nobody up for longer.

A service that `athrl train` started also has a pipe of its parent as standard input. When the parent goes,
however it goes, the pipe ends and the service drains as after a first signal, but not for ever.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

from athrl.errors import say

SIGNALS = (signal.SIGINT, signal.SIGTERM)
LIFELINE = "ATHRL_LIFELINE"
"""Environment variable that tells a service that its standard input is its parent's lifeline."""

STOP_SECONDS = 30.0
"""How long a service may take from the first signal to its end, unless it says otherwise."""

_MARGIN_SECONDS = 5
"""So much later the kernel ends a process whose interpreter does not get to it."""

FAREWELL_SECONDS = 10.0
"""How long a command that is done may take to leave."""

BROKEN_OFF = 1
"""Exit code of a service that did not drain in time."""

ORPHAN_SECONDS = 30.0
"""How long a service without its parent may take to drain."""


@contextmanager
def stop_on_signal(
    before_exit: Callable[[], None] | None = None,
    *,
    on_stop: Callable[[], None] | None = None,
    within: float = STOP_SECONDS,
) -> Iterator[threading.Event]:
    """Yield an event that the first SIGINT or SIGTERM sets; the second one ends the process at once.

    So does the end of `within` seconds after the first, wherever the process is then, also behind the block.
    `before_exit` is called before either, and `on_stop` after the first signal, both in another thread; they
    must not wait for anything.

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
        target=_read_signals, args=(reader, stop, on_stop, before_exit, within), name="signals", daemon=True
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


def _read_signals(
    reader: int,
    stop: threading.Event,
    on_stop: Callable[[], None] | None,
    before_exit: Callable[[], None] | None,
    within: float,
) -> None:
    """Set `stop` on the first signal and end the process on the second; return when the pipe is closed."""
    with os.fdopen(reader, "rb", buffering=0) as numbers:
        while number := numbers.read(1):
            if number[0] not in SIGNALS:
                continue
            if stop.is_set():
                if before_exit is not None:
                    before_exit()
                os._exit(128 + number[0])
            threading.Thread(target=_end_after, args=(within, before_exit), name="limit", daemon=True).start()
            signal.alarm(math.ceil(within) + _MARGIN_SECONDS)
            stop.set()
            if on_stop is not None:
                on_stop()


def _end_after(seconds: float, before_exit: Callable[[], None] | None) -> None:
    """End a process that is still there after so many seconds, and say in one line where it was."""
    time.sleep(seconds)
    say(f"stopping took more than {seconds:g} s and is broken off, in {_whereabouts()}")
    if before_exit is not None:
        before_exit()
    os._exit(BROKEN_OFF)


def _whereabouts() -> str:
    """Return the functions of athrl in which the main thread is, the outermost first."""
    frame = sys._current_frames().get(threading.main_thread().ident or 0)
    names: list[str] = []
    while frame is not None:
        module = frame.f_globals.get("__name__", "")
        if module.partition(".")[0].startswith("athrl"):
            names.append(f"{module}.{frame.f_code.co_name}")
        frame = frame.f_back
    return " > ".join(reversed(names[:3])) or "the interpreter's own end"


def _follow_parent(stop: threading.Event) -> None:
    """Drain when the parent's end of standard input is closed, and end the whole process group in the end."""
    while os.read(0, 4096):
        pass
    signal.alarm(math.ceil(ORPHAN_SECONDS) + _MARGIN_SECONDS)
    stop.set()
    time.sleep(ORPHAN_SECONDS)
    os.killpg(os.getpgrp(), signal.SIGKILL)
