"""Stopping a service: the first signal drains it, a second one ends it at once.

Draining has a limit from the first signal to the end of the process, so that a stuck disk, a session that
does not close or an import on a busy machine cannot delay the end any longer.

A service that `athrl train` started also has a pipe of its parent as standard input. When the parent ends in
any way, the pipe ends and the service drains as after a first signal, with a limit.
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
"""Default limit of a service from the first signal to its end."""

_MARGIN_SECONDS = 5
"""After so much longer the kernel ends a process whose interpreter is blocked."""

EXIT_SECONDS = 10.0
"""Limit for a finished command to end."""

NOT_DRAINED = 1
"""Exit code of a service that did not drain in time."""

ORPHAN_SECONDS = 30.0
"""Limit for a service without its parent to drain."""


@contextmanager
def stop_on_signal(
    before_exit: Callable[[], None] | None = None,
    *,
    on_stop: Callable[[], None] | None = None,
    within: float = STOP_SECONDS,
) -> Iterator[threading.Event]:
    """Yield an event that the first SIGINT or SIGTERM sets; the second one ends the process at once.

    The process also ends `within` seconds after the first signal, inside or after the block. `before_exit` is
    called before it ends in either way, `on_stop` after the first signal, both in another thread; they must
    not block.

    A separate thread reads the signals from a pipe (`signal.set_wakeup_fd`): setting an event in a
    signal handler can deadlock with the main thread waiting for that event, and a handler is not run at all
    while the main thread is inside a long call.
    """
    stop = threading.Event()
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    # The pipe before the handlers, so that no signal is lost.
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
    """Exit with this code, at the end of a command.

    Python waits for its threads when it exits. A thread that never ends, such as one with an abandoned
    environment, delays the exit by at most `EXIT_SECONDS`.
    """
    end = threading.Timer(EXIT_SECONDS, os._exit, (code,))
    end.daemon = True
    end.start()
    sys.exit(code)


def _ignore(number: int, frame: object) -> None:
    """Do nothing: the thread that reads the pipe handles the signal."""


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
    """End the process if it is still running after so many seconds, and print where it was."""
    time.sleep(seconds)
    say(f"stopping took more than {seconds:g} s and is aborted, in {_whereabouts()}")
    if before_exit is not None:
        before_exit()
    os._exit(NOT_DRAINED)


def _whereabouts() -> str:
    """Return the functions of athrl in the main thread's stack, the outermost first."""
    frame = sys._current_frames().get(threading.main_thread().ident or 0)
    names: list[str] = []
    while frame is not None:
        module = frame.f_globals.get("__name__", "")
        if module.partition(".")[0].startswith("athrl"):
            names.append(f"{module}.{frame.f_code.co_name}")
        frame = frame.f_back
    return " > ".join(reversed(names[:3])) or "the interpreter's own end"


def _follow_parent(stop: threading.Event) -> None:
    """Drain when the parent's end of standard input is closed; after the limit end the process group."""
    while os.read(0, 4096):
        pass
    signal.alarm(math.ceil(ORPHAN_SECONDS) + _MARGIN_SECONDS)
    stop.set()
    time.sleep(ORPHAN_SECONDS)
    os.killpg(os.getpgrp(), signal.SIGKILL)
