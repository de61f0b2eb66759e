"""Who looks at a run from outside leaves nothing of it behind, and is told when its learner is not heard."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable

import pytest
import zenoh
from athrl.run_view import RunSnapshot, RunView
from athrl_protocol import (
    EvaluationResult,
    MetricsReport,
    Phase,
    RunFile,
    RunState,
    StatePublisher,
    open_session,
    serve_run_file,
)

from athrl import run_view

PATIENCE = 120.0
LOOKS, SIDE_BY_SIDE = 30, 4

_LOOKS = """
import os, sys
from athrl.run_view import RunView
address, looks, side_by_side = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
living, codes = set(), []
while len(codes) < looks:
    if len(living) == side_by_side or len(codes) + len(living) == looks:
        child, status = os.wait()
        living.remove(child)
        codes.append(os.waitstatus_to_exitcode(status))
    elif child := os.fork():
        living.add(child)
    else:
        with RunView(address, None, timeout=30):
            pass
        sys.exit(7)
print(*codes)
"""
"""Processes that each look at the run and end as every Python does; forked, they import it all once."""


_LEARNER = """
import sys, time
from athrl_protocol import *
with (
    open_session(listen=sys.argv[1], timeout=30) as session,
    serve_run_file(session, RunFile()),
    announce_presence(session, RunFile().run.name, "learner", "learner"),
    StatePublisher(session, RunFile().run.name) as states,
):
    while True:
        states.publish(RunState(Phase.TRAINING, 10, 100, 1, 1, ""))
        time.sleep(0.2)
"""


def test_process_that_has_looked_at_a_run_ends_cleanly(address: str) -> None:
    """A thread that is inside Zenoh when the interpreter ends aborts the process, once in ten times or so."""
    with open_session(listen=address, timeout=PATIENCE) as learner, serve_run_file(learner, RunFile()):
        command = [sys.executable, "-c", _LOOKS, address, str(LOOKS), str(SIDE_BY_SIDE)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == ["7"] * LOOKS


def test_rate_of_the_warm_up_is_not_taken_for_that_of_training(address: str) -> None:
    run_file = RunFile()

    def snapshot(until: Callable[[RunSnapshot], bool]) -> RunSnapshot:
        deadline = time.monotonic() + PATIENCE
        while not until(now := view.snapshot()):
            assert time.monotonic() < deadline, now
            time.sleep(0.05)
        return now

    def in_phase(phase: Phase) -> Callable[[RunSnapshot], bool]:
        return lambda now: now.state is not None and now.state.phase is phase

    with (
        open_session(listen=address, timeout=PATIENCE) as learner,
        serve_run_file(learner, run_file),
        StatePublisher(learner, run_file.run.name) as states,
        RunView(address, None, timeout=PATIENCE) as view,
    ):
        states.publish(RunState(Phase.WARMING_UP, 0, 30_000, 0, 0, ""))
        snapshot(in_phase(Phase.WARMING_UP))
        states.publish(RunState(Phase.WARMING_UP, 2_000, 30_000, 0, 0, ""))
        assert (snapshot(lambda now: bool(now.steps_per_second)).steps_per_second or 0.0) > 100.0
        states.publish(RunState(Phase.TRAINING, 2_010, 30_000, 1, 0, ""))
        assert snapshot(in_phase(Phase.TRAINING)).steps_per_second is None
        assert snapshot(lambda now: now.steps_per_second is not None).steps_per_second == 0.0


def test_learner_that_is_lost_while_the_view_opens_is_told(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(session: zenoh.Session, run: str) -> list[str]:
        learner.close()
        deadline = time.monotonic() + PATIENCE
        while session.info.links():
            assert time.monotonic() < deadline
            time.sleep(0.01)
        return []

    monkeypatch.setattr(run_view, "SILENT_SECONDS", 0.1)
    monkeypatch.setattr(run_view, "fetch_changes", lost)
    with (
        open_session(listen=address, timeout=PATIENCE) as learner,
        serve_run_file(learner, RunFile()),
        RunView(address, None, timeout=PATIENCE) as view,
    ):
        time.sleep(0.2)
        assert f"no process listens at {address}" in view.snapshot().silence


def test_paused_learner_is_told_from_an_absent_one(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_view, "SILENT_SECONDS", 1.5)
    monkeypatch.setattr(run_view, "PROBE_SECONDS", 0.2)

    def until(told: str, *, connected: bool = True) -> None:
        deadline = time.monotonic() + PATIENCE
        while True:
            silence, is_connected = view.snapshot().silence, bool(view._session.info.links())
            if is_connected == connected and silence.partition(":")[0] == told:
                return
            assert time.monotonic() < deadline, silence
            time.sleep(0.05)

    with (
        subprocess.Popen([sys.executable, "-c", _LEARNER, address]) as learner,
        RunView(address, None, timeout=PATIENCE) as view,
    ):
        try:
            time.sleep(2.0)  # longer than one that is silent may be
            until("")
            learner.send_signal(signal.SIGSTOP)
            until("the learner is paused or very busy")
            until("the learner is paused or very busy", connected=False)
            learner.send_signal(signal.SIGCONT)
            until("")
        finally:
            learner.kill()
        until(f"the learner is absent, no process listens at {address.partition(':')[0]}", connected=False)


def test_reports_under_ever_new_names_do_not_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_view, "MOST_REPORTS", 100)
    view = RunView("tcp/127.0.0.1:1", None, timeout=1.0)
    for number in range(1000):
        view._on_metrics(MetricsReport("actor", f"a{number}", 1.0, {"speed": 1.0}))
        view._on_evaluation(EvaluationResult(f"made up {number}", 1, 1, "town03", 1, {}))
    assert len(view._reports) == 100
    assert ("actor", "a999") in view._reports
    assert len(view._evaluations) == run_view.MOST_DRIVERS
