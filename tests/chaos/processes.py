"""The run's processes: started and restarted as in a cluster, and all ended at the end."""

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
"""Environment variable that tells a service to end with the process that started it."""

BACK_OFF_SECONDS = 1.0
_KILLED_WITHIN = 10.0


class Ending(NamedTuple):
    """An exit of a service that was not requested."""

    service: str
    code: int
    last_line: str


class Service:
    """One service, which may be restarted; all output goes to one file."""

    def __init__(self, name: str, words: list[str], folder: Path, environment: Mapping[str, str]) -> None:
        self.name = name
        self.log = folder / f"{name}.log"
        self.wanted = False
        self.began_at = 0.0  # of the current process, monotonic
        self.starts = 0
        self.endings: list[Ending] = []
        self._words = words
        self._folder = folder
        paths = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        self._environment = {**os.environ, **environment, LIFELINE: "1", "PYTHONPATH": paths}
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.RLock()

    def start(self) -> None:
        """Start the process."""
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
        """Kill the process, and do not restart it."""
        with self._lock:
            self.wanted = False
            self._signal(signal.SIGKILL)
            self._wait(_KILLED_WITHIN)

    def stop(self, seconds: float) -> int | None:
        """Ask it to end gracefully; return its exit code, None if it did not end within `seconds`."""
        with self._lock:
            self.wanted = False
            self._signal(signal.SIGTERM)
            return self._wait(seconds)

    def pause(self) -> None:
        """Suspend the process."""
        self._signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Resume the process."""
        self._signal(signal.SIGCONT)

    def monitor(self) -> None:
        """Restart it if it ended without a request."""
        with self._lock:
            if not self.wanted or self._process is None or self._process.poll() is None:
                return
            self.endings.append(Ending(self.name, self._process.returncode, self.last_line()))
            self._close_lifeline()
            time.sleep(BACK_OFF_SECONDS)
            self.start()

    def end(self) -> None:
        """End the process and its child processes."""
        with self._lock:
            self.wanted = False
            if self._process is not None:
                for number in (signal.SIGCONT, signal.SIGKILL):
                    self._signal(number)
                self._wait(_KILLED_WITHIN)
                self._close_lifeline()

    def said(self) -> str:
        """Return the output of all its processes."""
        return self.log.read_text(errors="replace") if self.log.exists() else ""

    def last_line(self) -> str:
        """Return the last line of its output."""
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
    """Restarts services from a separate thread; a context manager that ends all of them."""

    def __init__(self, services: list[Service]) -> None:
        self._services = services
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._monitor_all, name="supervisor", daemon=True)

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

    def _monitor_all(self) -> None:
        while not self._over.wait(0.1):
            for service in self._services:
                service.monitor()
