"""What tests across services share: the command as a user runs it, with nothing of it left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import psutil
import pytest
from athrl.run_view import RunSnapshot, RunView
from athrl.runs import declare_installed_planners
from athrl_protocol.run_file import declare_planners, declared_planners

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests is no installed package

MARK = "ATHRL_TEST"

TINY: dict[str, object] = {
    "run.environment_steps": 800,
    "environment.vehicles": 10,
    "environment.episode_ticks": 120,
    "exploration.random_decisions": 100,
    "planner.hidden_features": 16,
    "planner.head_features": 16,
    "replay.capacity": 2000,
    "learner.batch": 40,
    "learner.samples_per_insert": 4.0,
    "learner.publish_seconds": 0.5,
    "learner.checkpoint_seconds": 2.0,
    "actor.environments": 2,
    "evaluator.episodes": 2,
    "evaluator.final_episodes": 2,
    "evaluator.seconds_between": 1.0,
}
"""Settings of a run that lasts seconds."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--compose", action="store_true", help="run the tests that build on containers")
    parser.addoption("--kubernetes", action="store_true", help="run what manifests say in containers")
    parser.addoption("--slurm", action="store_true", help="run the tests that start a Slurm on this machine")


def _hear_interrupts() -> None:
    """A shell starts what it puts in the background deaf to SIGINT, which pytest's children would inherit."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@dataclass
class Command:
    """Runs `athrl` in a folder; every process carries a mark by which it is found however it was started."""

    folder: Path
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)
    started: list[subprocess.Popen[str]] = field(default_factory=list)

    def environment(self) -> dict[str, str]:
        return {
            **os.environ,
            MARK: self.mark,
            "PYTHONFAULTHANDLER": "1",
            "OMP_NUM_THREADS": "1",
            "COLUMNS": "200",
        }

    def run(self, *arguments: str, seconds: float) -> subprocess.CompletedProcess[str]:
        """Run the command to its end, which must come within so many seconds."""
        return subprocess.run(
            [sys.executable, "-m", "athrl", *arguments],
            cwd=self.folder,
            env=self.environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=seconds,
        )

    def run_together(self, calls: list[list[str]], seconds: float) -> list[subprocess.CompletedProcess[str]]:
        """Run several commands at the same time, each to its end."""
        with ThreadPoolExecutor(len(calls)) as pool:
            return list(pool.map(lambda arguments: self.run(*arguments, seconds=seconds), calls))

    def start(self, *arguments: str, within: tuple[str, ...] = ()) -> subprocess.Popen[str]:
        """Start the command with its output in a file of the folder, which `said` reads.

        `within` are words before it, such as of another command that runs it.
        """
        log = self.folder / f"{len(self.started)}-{arguments[0]}.log"
        with log.open("w") as output:
            process = subprocess.Popen(
                [*within, sys.executable, "-m", "athrl", *arguments],
                cwd=self.folder,
                env=self.environment(),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                text=True,
                preexec_fn=_hear_interrupts,
            )
        process.log = log  # type: ignore[attr-defined]
        self.started.append(process)
        return process

    def said(self, process: subprocess.Popen[str]) -> str:
        """Return what a started process has written so far."""
        return process.log.read_text()  # type: ignore[attr-defined]

    def wait_until_said(self, process: subprocess.Popen[str], words: str, seconds: float) -> None:
        """Wait until a started process has written `words`.

        Fails with all that it has written when it ends before, or does not come to it within so many
        seconds; in the latter case it writes before where its threads are.
        """
        deadline = time.monotonic() + seconds
        while words not in self.said(process):
            if process.poll() is not None and words not in self.said(process):
                pytest.fail(f"ended without {words!r}, with {process.returncode}:\n{self.said(process)}")
            if time.monotonic() > deadline:
                process.send_signal(signal.SIGABRT)
                process.wait(timeout=10)
                pytest.fail(f"did not say {words!r} within {seconds} s:\n{self.said(process)}")
            time.sleep(0.1)

    def left(self) -> list[psutil.Process]:
        """Return the processes that carry this test's mark and live."""
        found = []
        for process in psutil.process_iter():
            try:
                if process.status() != psutil.STATUS_ZOMBIE and process.environ().get(MARK) == self.mark:
                    found.append(process)
            except psutil.Error:
                continue
        return [process for process in found if process.pid != os.getpid()]

    def end_all(self) -> None:
        """End whatever carries the mark."""
        for process in self.left():
            try:
                process.send_signal(signal.SIGKILL)
            except psutil.Error:
                continue
        for started in self.started:
            started.wait(timeout=10)


@pytest.fixture(scope="module", autouse=True)
def _planners() -> Iterator[None]:
    """Run files that a test reads itself are held to the planners' settings, as the command's are."""
    before = declared_planners()
    declare_installed_planners()
    yield
    declare_planners(before)


@pytest.fixture
def command(tmp_path: Path) -> Iterator[Command]:
    """The command in an empty folder; what it leaves running is ended after the test."""
    command = Command(tmp_path)
    yield command
    command.end_all()


@pytest.fixture(scope="module")
def shared_command(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Command]:
    """The command in a folder that all tests of a module share."""
    command = Command(tmp_path_factory.mktemp("shared"))
    yield command
    command.end_all()


def words_of(settings: dict[str, object]) -> list[str]:
    """Settings as words of the command line."""
    return [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]


@pytest.fixture
def tiny(port: int) -> list[str]:
    """Settings of a run that lasts seconds and listens at `port`, as words of the command line."""
    return words_of({**TINY, "network.listen": f"tcp/127.0.0.1:{port}"})


@pytest.fixture(scope="session")
def another_tiny(free_address: Callable[[], str]) -> Callable[[dict[str, object]], list[str]]:
    """Gives such words with changed settings, for a run that listens at its own port each time."""

    def words(changes: dict[str, object]) -> list[str]:
        return words_of({**TINY, "network.listen": free_address(), **changes})

    return words


@pytest.fixture
def eventually() -> Callable[[Callable[[], object], float], None]:
    """Wait until a condition holds, at most so many seconds."""

    def wait(condition: Callable[[], object], seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, f"not within {seconds} s"
            time.sleep(0.1)

    return wait


@pytest.fixture
def seen() -> Callable[[str, str, Callable[[RunSnapshot], object], float], RunSnapshot]:
    """Wait until a live run at an address is as a condition says, at most so many seconds; return it.

    It is looked at from this process: a command that looks costs more than a second of a core each time,
    which the run that is waited for needs itself.
    """

    def wait(
        address: str, run: str, condition: Callable[[RunSnapshot], object], seconds: float
    ) -> RunSnapshot:
        deadline = time.monotonic() + seconds
        with RunView(address, run, timeout=seconds) as view:
            while not condition(snapshot := view.snapshot()):
                assert time.monotonic() < deadline, f"not within {seconds} s: {snapshot}"
                time.sleep(0.1)
        return snapshot

    return wait
