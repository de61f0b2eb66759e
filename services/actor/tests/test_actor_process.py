"""`athrl actor` as a process: a fatal error is one line and an exit code, without waiting."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

PATIENCE = 120.0

STALLING = """
import time
from athrl_driving.policy import EnvironmentBatch
step, calls = EnvironmentBatch.step, []
def stall_in_the_end(batch, *arguments):
    calls.append(1)
    if len(calls) > 12:
        time.sleep(3600)
    return step(batch, *arguments)
EnvironmentBatch.step = stall_in_the_end
"""
THREAD_FAILS = """
from athrl_protocol.delivery.upload_window import UploadWindow
def fail(*arguments):
    raise MemoryError("no room for an acknowledgement")
UploadWindow.acknowledge = fail
"""
CALLBACK_FAILS = """
from athrl_protocol.announcements.latest_value import LatestSubscriber
def fail(*arguments):
    raise KeyError("edition")
LatestSubscriber._keep = fail
"""


def leave(learner: Any, harm: str, folder: Path) -> tuple[int, str, list[str]]:
    """Run an actor with an injected fault; its exit code, standard output, and lines on standard error."""
    program = f"{harm}\nfrom athrl.command import main\nmain()"
    command = [sys.executable, "-c", program, "actor", "--connect", learner.address, "--run", "test"]
    with (folder / "errors").open("wb") as errors:
        process = subprocess.Popen([*command, "--name", "one"], stdout=subprocess.PIPE, stderr=errors)
        try:
            output, _ = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
            process.wait()
    lines = (folder / "errors").read_text().splitlines()
    return process.returncode, output.decode(), lines


def configure(learner: Any, **settings: Any) -> None:
    actor = learner.run_file.actor.model_copy(update=settings)
    learner.close()
    learner.run_file = learner.run_file.model_copy(update={"actor": actor})
    learner.open()


def test_actor_whose_environments_stall_repeatedly_exits_with_code_2(learner, tmp_path) -> None:
    configure(learner, stall_seconds=0.5, failures_allowed=2)
    learner.publish(0)
    code, output, lines = leave(learner, STALLING, tmp_path)
    assert code == 2
    assert output == ""
    assert lines[-1] == (
        "athrl: the environments failed 3 times within 600 s, actor.failures_allowed is 2; the last time: "
        "step did not return within 0.5 s"
    )
    assert not any("Traceback" in line for line in lines)
    assert sum("restarting 2 episodes" in line for line in lines) == 2
    assert learner.wait_for(lambda: learner.reports[-1].values["environments_stalled"] == 3)
    values = learner.reports[-1].values  # its last words account for every chunk
    assert values["chunks_produced"] == values["chunks_acknowledged"] == len(learner.chunks) > 0


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (THREAD_FAILS, "the upload failed: MemoryError: no room for an acknowledgement"),
        (CALLBACK_FAILS, "the subscription to athrl/test/"),
    ],
)
def test_actor_with_a_failed_thread_exits_with_the_reason(learner, tmp_path, harm: str, said: str) -> None:
    learner.publish(0)
    code, output, lines = leave(learner, harm, tmp_path)
    assert code == 2
    assert output == ""
    assert lines[-1].startswith(f"athrl: {said}")
    assert "Error: " in lines[-1]
    assert not any("Traceback" in line for line in lines)
