"""The run's processes: started as a cluster would, started again when they die, and all gone at the end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
LIFELINE = "ATHRL_LIFELINE"
"""Tells a service that its standard input ends with the process that started it."""

BACK_OFF_SECONDS = 1.0
_KILLED_WITHIN = 10.0


class Ending(NamedTuple):
    """A service that ended without being told to."""

    service: str
    code: int
    last_line: str


class Service:
    """One service, which lives several times; its output goes into one file."""

    def __init__(self, name: str, words: list[str], folder: Path, environment: Mapping[str, str]) -> None:
        self.name = name
        self.log = folder / f"{name}.log"
        self.wanted = False
        self.began_at = 0.0  # of this life, monotonic
        self.starts = 0
        self.endings: list[Ending] = []
        self._words = words
        self._folder = folder
        paths = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        self._environment = {**os.environ, **environment, LIFELINE: "1", "PYTHONPATH": paths}
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.RLock()

    def start(self) -> None:
        """Begin a life."""
        with self._lock, self.log.open("ab") as output:
            self.wanted = True
            self.starts += 1
            self.began_at = time.monotonic()
            self._process = subprocess.Popen(
                [sys.executable, "-m", *self._words],
                cwd=self._folder,
                env=self._environment,
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def kill(self) -> None:
        """End it at this instruction, and do not start it again."""
        with self._lock:
            self.wanted = False
            self._signal(signal.SIGKILL)
            self._wait(_KILLED_WITHIN)

    def stop(self, seconds: float) -> int | None:
        """Ask it to end in order, and return its exit code; None if it did not within so many seconds."""
        with self._lock:
            self.wanted = False
            self._signal(signal.SIGTERM)
            return self._wait(seconds)

    def pause(self) -> None:
        """Let it stand still."""
        self._signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Let it go on."""
        self._signal(signal.SIGCONT)

    def look_after(self) -> None:
        """Start it again if it ended by itself."""
        with self._lock:
            if not self.wanted or self._process is None or self._process.poll() is None:
                return
            self.endings.append(Ending(self.name, self._process.returncode, self.last_line()))
            self._close_lifeline()
            time.sleep(BACK_OFF_SECONDS)
            self.start()

    def end(self) -> None:
        """Make sure that nothing of it is left."""
        with self._lock:
            self.wanted = False
            if self._process is not None:
                for number in (signal.SIGCONT, signal.SIGKILL):
                    self._signal(number)
                self._wait(_KILLED_WITHIN)
                self._close_lifeline()

    def said(self) -> str:
        """Return everything that it has written in all its lives."""
        return self.log.read_text(errors="replace") if self.log.exists() else ""

    def last_line(self) -> str:
        """Return what it said last."""
        lines = self.said().strip().splitlines()
        return lines[-1] if lines else ""

    def _signal(self, number: signal.Signals) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(number)

    def _wait(self, seconds: float) -> int | None:
        if self._process is None:
            return None
        try:
            code = self._process.wait(timeout=seconds)
        except subprocess.TimeoutExpired:
            return None
        self._close_lifeline()
        return code

    def _close_lifeline(self) -> None:
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()


class Supervisor:
    """Looks after all services from a thread of its own; a context manager that leaves none behind."""

    def __init__(self, services: list[Service]) -> None:
        self._services = services
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look_after_all, name="supervisor", daemon=True)

    def __enter__(self) -> Supervisor:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        for service in self._services:
            service.end()
        self._thread.join(timeout=_KILLED_WITHIN)
        for service in self._services:
            service.end()

    def _look_after_all(self) -> None:
        while not self._over.wait(0.1):
            for service in self._services:
                service.look_after()
