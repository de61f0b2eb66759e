"""One run from outside: `athrl train` as a child process that is resumed and drained."""

from __future__ import annotations

import fcntl
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from athrl_protocol.announcements.comparison import compared_decisions
from athrl_protocol.run_file.toml_values import to_toml_value

from athrl.errors import CommandError
from athrl.runs import holds_run
from athrl.stopping import ORPHAN_SECONDS
from athrl.train.process import ServiceProcess
from athrl.train.session import STOP_SECONDS

POLL_SECONDS = 0.5
LEFT_SECONDS = 2 * ORPHAN_SECONDS + STOP_SECONDS
"""How long the processes of a study that was killed may take until they have left their run."""


class RunFailed(CommandError):  # noqa: N818  (the name says what happened)
    """A run or its evaluation did not reach its end; the text is one line that says why."""


class Stopped(Exception):  # noqa: N818
    """It was drained because somebody asked; started again it continues."""


def train_words(
    folder: Path, overrides: Sequence[str], *, run_file: Path | None = None, address: str
) -> list[str]:
    """Return the words of `athrl train` that start a run, or resume the one in its folder.

    Args:
        folder: of the run; its name is the run's.
        overrides: settings of a new run, `section.key=value`. A resumed one keeps those it has.
        run_file: more settings of a new run.
        address: where its learner listens.
    """
    words = ["train", "--viewer-port", "0"]
    if holds_run(folder):
        words += ["--resume", str(folder)]
    else:
        words += ["--name", folder.name]
        words += ["--run-file", str(run_file)] if run_file is not None else []
        words += _set([f"run.folder={to_toml_value(str(folder.parent))}", *overrides])
    return words + _set([f"network.listen={address}"])


def train(
    folder: Path,
    words: Callable[[], Sequence[str]],
    decisions: int,
    log: Path,
    stop: threading.Event,
    *,
    limit_seconds: float,
    look: Callable[[], None] = lambda: None,
) -> float | None:
    """Train a run to its closing comparison, from where it is.

    Args:
        folder: of the run.
        words: gives the words of `athrl train`, asked when the folder is free.
        decisions: at which the run is finished.
        log: to which is appended what the command says.
        stop: drains the run when it is set.
        limit_seconds: in which the run must be finished.
        look: called again and again while it runs; what it raises drains the run.

    Returns:
        Seconds that it took; None if the run was resumed, or finished before.

    Raises:
        RunFailed: it ended too early or not in time.
        Stopped: it was drained.
    """
    if compared_decisions(folder) >= decisions:
        return None
    # The command keeps the lock: one of a study that was killed may still be starting, or draining.
    with _locked(log.with_suffix(".lock"), stop) as lock:
        _wait_until_free(folder / "learner.lock", stop)
        resumed = holds_run(folder)
        process = ServiceProcess(folder.name, list(words()), log, kept_open=(lock.fileno(),))
        began = time.monotonic()
        run_to_end(process, stop, limit_seconds, STOP_SECONDS, look)
    return None if resumed else round(time.monotonic() - began, 1)


def run_to_end(
    process: ServiceProcess,
    stop: threading.Event,
    limit_seconds: float,
    drain_seconds: float,
    look: Callable[[], None],
) -> None:
    """Run a command to its end; on `stop`, on an error and at the limit ask it to drain, and end it.

    Raises:
        RunFailed: it ended with an error or not in time.
        Stopped: it was drained.
    """
    if stop.is_set():
        raise Stopped
    deadline = time.monotonic() + limit_seconds
    process.start()
    try:
        while process.exit_code is None:
            if stop.wait(POLL_SECONDS):
                raise Stopped
            if time.monotonic() > deadline:
                raise RunFailed(f"did not end within {limit_seconds / 3600:g} h: see {process.log}")
            look()
    finally:
        process.terminate()
        process.wait(drain_seconds)
        process.end()
    if process.exit_code != 0:
        said = (process.last_lines(1) or ["without a word"])[0].removeprefix("athrl: ")
        raise RunFailed(f"ended with code {process.exit_code}: {said}")


@contextmanager
def _locked(path: Path, stop: threading.Event) -> Iterator[IO[bytes]]:
    """Hold the lock of a file, which is made if it is missing; raises as `_wait_for` does."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab") as file:
        _wait_for(file, stop)
        yield file


def _wait_until_free(lock: Path, stop: threading.Event) -> None:
    """Wait until no learner holds the lock, which need not exist; raises as `_wait_for` does."""
    if lock.exists():
        with _locked(lock, stop):
            pass


def _wait_for(file: IO[bytes], stop: threading.Event) -> None:
    """Wait for the lock of an open file and take it.

    Raises:
        RunFailed: another process holds it for too long.
        Stopped: `stop` was set before.
    """
    deadline = time.monotonic() + LEFT_SECONDS
    while True:
        try:
            return fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline:
                raise RunFailed(
                    f"another process has held {file.name} for {LEFT_SECONDS:.0f} s: stop it"
                ) from None
        if stop.wait(POLL_SECONDS):
            raise Stopped


def _set(settings: Sequence[str]) -> list[str]:
    return [word for setting in settings for word in ("--set", setting)]
