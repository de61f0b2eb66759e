"""Observes the run: metrics of the services, and copies of files that the learner will remove."""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import threading
import time
from types import TracebackType
from typing import Self

import zenoh
from athrl_learner.log import numbered_segments
from athrl_protocol import MetricsReport, MetricsSubscriber, open_session

from tests.chaos.run import RUN, ChaosRun

_POLL_SECONDS = 0.1


class Observer:
    """A viewer of the run that bypasses all links; a context manager.

    Attributes:
        first_policy: copy of the first policy that the learner wrote.
        not_finite: metrics that were not finite.
    """

    def __init__(self, run: ChaosRun, timeout: float) -> None:
        self._run = run
        self._timeout = timeout
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._newest: dict[tuple[str, str], tuple[float, dict[str, float]]] = {}
        self._session: zenoh.Session | None = None
        self._thread = threading.Thread(target=self._archive_until_over, name="archive", daemon=True)
        self.first_policy = run.folder / "first.onnx"
        self.not_finite: set[str] = set()

    def __enter__(self) -> Self:
        self._session = open_session(
            connect=self._run.address, timeout=self._timeout, certificates=self._run.certificates
        )
        self._subscriber = MetricsSubscriber(self._session, RUN, self._take)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join(timeout=10.0)
        if self._session is not None:
            self._session.close()

    def last_report_at(self, role: str, name: str) -> float:
        """Return when (monotonic seconds) the service last reported; -1 if it never did."""
        with self._lock:
            return self._newest.get((role, name), (-1.0, {}))[0]

    def metrics(self, role: str, name: str) -> dict[str, float]:
        """Return the service's newest metrics."""
        with self._lock:
            return dict(self._newest.get((role, name), (-1.0, {}))[1])

    def archive(self) -> None:
        """Hard-link every segment, so that it stays when the learner removes it."""
        for path in numbered_segments(self._run.run_folder / "experience").values():
            with contextlib.suppress(FileExistsError, FileNotFoundError):
                os.link(path, self._run.archive / path.name)
        policy = self._run.run_folder / "policies" / "latest.onnx"
        if not self.first_policy.exists() and policy.exists():
            shutil.copyfile(policy, self.first_policy)

    def _archive_until_over(self) -> None:
        while not self._over.wait(_POLL_SECONDS):
            self.archive()

    def _take(self, report: MetricsReport) -> None:
        with self._lock:
            self._newest[report.role, report.name] = (time.monotonic(), report.values)
            bad = (name for name, value in report.values.items() if not math.isfinite(value))
            self.not_finite.update(f"{report.name}: {name}" for name in bad)
