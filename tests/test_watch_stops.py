"""A signal to either process ends `athrl watch FILE --serve PORT` quietly, and rerun with it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

SECONDS = 60.0
START_SECONDS = 150.0


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short episode, recorded by the command itself."""
    folder = tmp_path_factory.mktemp("recorded")
    words = ["--policy", "blind", "--episodes", "2", "--set", "environment.episode_ticks=40", "--record", "."]
    evaluate = [sys.executable, "-m", "athrl", "evaluate", *words]
    subprocess.run(evaluate, cwd=folder, check=True, capture_output=True, timeout=300)
    return min(folder.glob("*.mcap"))


@pytest.fixture
def watching(command, recording: Path, port: int) -> subprocess.Popen[str]:
    """The command in its own process group, as a shell starts it, when it shows the recording."""
    process = command.start("watch", str(recording), "--serve", str(port), within=("setsid",))
    command.wait_until_said(process, "showing", START_SECONDS)
    return process


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("send", [os.kill, os.killpg], ids=["to-it-alone", "to-its-group"])
def test_a_signal_ends_it_with_0_and_without_a_word(command, watching, send, number: int) -> None:
    said = command.said(watching)
    send(watching.pid, number)
    assert watching.wait(SECONDS) == 0
    assert command.said(watching) == said
    assert command.left() == []


def test_a_kill_leaves_no_rerun(command, watching, eventually) -> None:
    assert len(command.left()) == 2, "rerun is a separate process"
    watching.kill()
    watching.wait(SECONDS)
    eventually(lambda: command.left() == [], SECONDS)
