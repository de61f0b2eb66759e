"""Who looks at a run from outside leaves nothing of it behind."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from athrl.run_view import RunSnapshot, RunView
from athrl_protocol import Phase, RunFile, RunState, StatePublisher, open_session, serve_run_file

PATIENCE = 30.0
LOOKS = 30

_LOOK = """
import sys
from athrl.run_view import RunView
with RunView(sys.argv[1], None, timeout=30):
    pass
"""


def _free_address() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def test_process_that_has_looked_at_a_run_ends_cleanly() -> None:
    """A thread that is inside Zenoh when the interpreter ends aborts the process, once in ten times or so."""
    address = _free_address()

    def look(_: int) -> tuple[int, str]:
        command = [sys.executable, "-c", _LOOK, address]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
        return done.returncode, done.stderr

    with (
        open_session(listen=address, timeout=PATIENCE) as learner,
        serve_run_file(learner, RunFile()),
        ThreadPoolExecutor(4) as looking,
    ):
        assert set(looking.map(look, range(LOOKS))) == {(0, "")}


def test_rate_of_the_warm_up_is_not_taken_for_that_of_training() -> None:
    address, run_file = _free_address(), RunFile()

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
