"""One service of a run as a child process."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from athrl_spaces.wording import system_reason

from athrl.errors import CommandError
from athrl.stopping import LIFELINE

# Numerical libraries start a thread for every core unless told otherwise; the services share the cores.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

END_SECONDS = 10.0
"""Within which a process that was killed is gone, unless the kernel waits for a disk in its place."""


@dataclass
class ServiceProcess:
    """A subcommand of `athrl` as a child process in its own process group.

    It has its own session, so that Ctrl-C in the terminal only reaches `athrl train`, which then stops the
    services in order. Its standard input is a pipe without data: it ends with this process, and then the
    service stops (`athrl.stopping`). `threads` is the number of threads of its numerical libraries. It keeps
    the file descriptors `kept_open`, and with them their locks.
    """

    name: str
    arguments: list[str]
    log: Path
    niceness: int = 0
    threads: int = 1
    kept_open: tuple[int, ...] = ()
    command: list[str] = field(default_factory=lambda: [sys.executable, "-m", "athrl"])
    started_at: float = field(default=0.0, init=False)
    _process: subprocess.Popen[bytes] | None = field(default=None, init=False)
    _log_start: int = field(default=0, init=False)
    _ended: subprocess.Popen[bytes] | None = field(default=None, init=False)

    def start(self, extra_arguments: list[str] | None = None) -> None:
        """Start the process; its output is appended to its log.

        Raises:
            CommandError: the log cannot be written, or the system starts no process, such as one too many.
        """
        environment = {**os.environ, LIFELINE: "1", "PYTHONUNBUFFERED": "1"}
        environment.update(dict.fromkeys(_THREADS, str(self.threads)))
        try:
            self.log.parent.mkdir(parents=True, exist_ok=True)
            log = self.log.open("ab")
        except OSError as error:
            raise CommandError(f"cannot write {self.log}: {system_reason(error)}") from None
        with log:
            self._log_start = log.tell()
            try:
                self._process = subprocess.Popen(
                    [*self.command, *self.arguments, *(extra_arguments or [])],
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=log,
                    env=environment,
                    start_new_session=True,
                    pass_fds=self.kept_open,
                )
            except OSError as error:
                reason = system_reason(error)
                raise CommandError(f"cannot start {self.name}: {reason}") from None
        self.started_at = time.monotonic()
        if self.niceness:
            os.setpriority(os.PRIO_PROCESS, self._process.pid, self.niceness)

    @property
    def exit_code(self) -> int | None:
        """Exit code of the last process, negative for a signal; None while it runs or before its start."""
        return None if self._process is None else self._process.poll()

    @property
    def running(self) -> bool:
        """Whether the process was started and has not ended."""
        return self._process is not None and self._process.poll() is None

    def terminate(self) -> None:
        """Ask the service to drain."""
        if self._process is not None and self.running:
            self._process.terminate()

    def wait(self, seconds: float) -> bool:
        """Wait at most `seconds` for the process to end; return whether it has."""
        if self._process is None:
            return True
        try:
            self._process.wait(timeout=max(seconds, 0.0))
        except subprocess.TimeoutExpired:
            return False
        return True

    def kill(self) -> None:
        """End the process and its child processes, without waiting.

        Nothing after `end`: by then another process may have their number.
        """
        if self._process is not None and self._process is not self._ended:
            with contextlib.suppress(ProcessLookupError):  # the group has ended with its last process
                os.killpg(self._process.pid, signal.SIGKILL)

    def end(self) -> None:
        """End the process and its child processes, and wait for it.

        Raises:
            CommandError: it is still there.
        """
        if self._process is None:
            return
        self.kill()
        if self._process.stdin is not None:
            self._process.stdin.close()
        if not self.wait(END_SECONDS):
            raise CommandError(
                f"{self.name} was killed and still runs after {END_SECONDS:g} s: does a disk not answer?"
            )
        self._ended = self._process

    def last_lines(self, count: int = 5) -> list[str]:
        """Return the last lines that the newest process wrote."""
        try:
            with self.log.open("rb") as log:
                log.seek(self._log_start)
                text = log.read().decode(errors="replace")
        except OSError:
            return []
        return [line for line in text.splitlines() if line.strip()][-count:]
