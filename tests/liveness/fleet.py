"""A run of real processes that can be paused, killed and cut off, and what its learner has on disk."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh
from athrl_learner.log import numbered_segments
from athrl_protocol import MetricsReport, MetricsSubscriber, open_session

from tests.chaos.audit import read_log

RUN = "alive"
STARTING = 240.0
"""A machine at work with other things takes a minute to load everything."""
RETURN = 15.0
"""Limit for the run to recover after the last service has returned; on an idle machine it takes 3 s."""
LEAVING = 60.0


@dataclass(frozen=True)
class Mark:
    """A place in the learner's log."""

    segment: int
    size: int


@dataclass
class Fleet:
    """The services of a run by name.

    Args:
        command: which runs `athrl`, see `tests/conftest.py`.
        settings: of the learner, as words of its command line.
        address: of the learner.
    """

    command: Any
    settings: list[str]
    address: str
    processes: dict[str, subprocess.Popen[str]] = field(default_factory=dict)
    arguments: dict[str, tuple[list[str], tuple[str, ...]]] = field(default_factory=dict)
    reports: dict[str, MetricsReport] = field(default_factory=dict)
    last_report_at: dict[str, float] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        """The run's folder."""
        return Path(self.command.folder) / "runs" / RUN

    def watch(self) -> zenoh.Session:
        """Subscribe to all metrics; the caller closes the returned subscriber."""
        session = open_session(connect=self.address, timeout=STARTING)
        self._subscriber = MetricsSubscriber(session, RUN, self._take)
        return session

    def _take(self, report: MetricsReport) -> None:
        self.reports[report.name] = report
        self.last_report_at[report.name] = time.monotonic()

    def start(self, name: str, service: str, *arguments: str, within: tuple[str, ...] = ()) -> None:
        """Start a service; `within` are words before its command line."""
        self.arguments[name] = ([service, *arguments], within)
        self.processes[name] = self.command.start(service, *arguments, within=within)

    def start_learner(self) -> None:
        """Start the learner, which resumes an existing run."""
        named = ["--set", f"run.name={RUN}", "--resume-if-present"]
        self.start("learner", "learner", *self.settings, *named)

    def start_client(
        self, name: str, service: str, address: str | None = None, within: tuple[str, ...] = ()
    ) -> None:
        """Start an actor or an evaluator at the learner's address, or at a router's."""
        where = ["--connect", address or self.address, "--run", RUN, "--name", name]
        self.start(name, service, *where, within=within)

    def signal(self, names: Iterable[str], number: signal.Signals) -> None:
        """Send a signal to services."""
        for name in names:
            os.kill(self._pid(name), number)

    def _pid(self, name: str) -> int:
        return self.processes[name].pid

    def kill(self, name: str) -> None:
        """Kill a service and wait for its end."""
        self.processes[name].kill()
        self.processes[name].wait(timeout=LEAVING)

    def start_again(self, name: str) -> None:
        """Start a service that was killed, as it was started before."""
        arguments, within = self.arguments[name]
        self.processes[name] = self.command.start(*arguments, within=within)

    def mark(self) -> Mark:
        """Return where the learner's log ends now."""
        segments = numbered_segments(self.folder / "experience")
        newest = max(segments, default=0)
        return Mark(newest, segments[newest].stat().st_size if segments else 0)

    def stored_since(self, mark: Mark) -> bytes:
        """Return what the learner has written down since."""
        segments = numbered_segments(self.folder / "experience")
        content = b""
        for number, path in sorted(segments.items()):
            if number >= mark.segment:
                content += path.read_bytes()[mark.size if number == mark.segment else 0 :]
        return content

    def await_storing(self, actors: Iterable[str], since: Mark, seconds: float) -> dict[str, float]:
        """Wait until chunks of all these actors were stored; return after how many seconds each was."""
        began, waiting, after = time.monotonic(), set(actors), {}
        while waiting:
            content = self.stored_since(since)
            for name in [name for name in waiting if name.encode() in content]:
                waiting.discard(name)
                after[name] = time.monotonic() - began
            assert not waiting or time.monotonic() - began < seconds, self.story(waiting)
            time.sleep(0.02)
        return after

    def await_word(self, name: str, seconds: float) -> float:
        """Wait until a service has reported again; return after how many seconds it did."""
        began = time.monotonic()
        while self.last_report_at.get(name, 0.0) < began:
            assert time.monotonic() - began < seconds, self.story([name])
            time.sleep(0.02)
        return time.monotonic() - began

    def story(self, names: Iterable[str], lines: int = 15) -> str:
        """What the services, the learner and the router said last, for a test that fails."""
        said = []
        for name in sorted({"learner", *names, *self.processes.keys() & {"router"}}):
            said += [f"--- {name}: {self.processes[name].poll()}"]
            said += self.command.said(self.processes[name]).splitlines()[-lines:]
            if name in self.reports:
                counts = {key: value for key, value in self.reports[name].values.items() if "chunk" in key}
                said += [f"{time.monotonic() - self.last_report_at[name]:.1f} s ago: {counts}"]
        return "\n".join(said)

    def leave(self) -> None:
        """Stop all services, and compare the learner's log with the acknowledgements."""
        clients = [name for name in self.processes if name not in ("router", "learner")]
        codes = {}
        for names in (clients, [name for name in ("router", "learner") if name in self.processes]):
            self.signal(names, signal.SIGTERM)
            codes |= {name: self._end_of(name) for name in names}
            time.sleep(1.0)  # last reports are on their way
        assert set(codes.values()) == {0}, self.story(codes)
        self._check_balance()

    def _end_of(self, name: str) -> int:
        """Return a service's exit code; one that does not leave says where it is, and the test fails."""
        process = self.processes[name]
        try:
            return process.wait(timeout=LEAVING)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGABRT)  # see PYTHONFAULTHANDLER
            process.wait(timeout=LEAVING)
            raise AssertionError(f"{name} did not leave\n{self.story([name], lines=80)}") from None

    def _check_balance(self) -> None:
        """Every chunk once and without a gap, and no fewer than an actor was told that are safe."""
        log = read_log(self.folder / "experience")
        assert log.problems == []
        identities = [identity for identity, _ in log.chunks]
        assert len(set(identities)) == len(identities)
        stored = Counter((identity.actor, identity.incarnation) for identity in identities)
        for (actor, incarnation), count in stored.items():
            sequences = [
                each.sequence for each in identities if (each.actor, each.incarnation) == (actor, incarnation)
            ]
            assert sequences == list(range(count)), actor
        for name, report in self.reports.items():
            if "chunks_acknowledged" in report.values:
                newest = max(incarnation for actor, incarnation in stored if actor == name)
                safe, waiting = report.values["chunks_acknowledged"], report.values["chunks_waiting"]
                # Reports are dropped where a queue is full, so an actor's last one may be missing. One that
                # leaves without a warning has had everything acknowledged that it told of as waiting.
                said = self.command.said(self.processes[name])
                assert "were not acknowledged" not in said, self.story([name])
                if waiting == 0:
                    assert safe == stored[name, newest], report
                else:
                    assert safe + waiting <= stored[name, newest], report
                assert report.values["chunks_waiting"] == 0
