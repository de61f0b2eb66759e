"""`athrl record` films with the options that it is given, and refuses others in one line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import imageio_ffmpeg
import psutil
import pytest
from athrl.errors import CommandError
from athrl.record import record

COMMAND = [sys.executable, "-m", "athrl", "record"]


def test_a_video_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    options = ["--town", "town02", "--seed", "4", "--seconds", "1", "--size", "128x64"]
    result = subprocess.run(
        [*COMMAND, "blind", "--video", path, *options],
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout == f"{path}: 10 pictures, 1 s of blind in town02\n"
    assert next(imageio_ffmpeg.read_frames(path))["size"] == (128, 64)


def test_a_signal_ends_it_and_leaves_nothing(tmp_path: Path) -> None:
    process = filming(tmp_path)
    process.send_signal(signal.SIGTERM)
    _, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (130, "")
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_in_a_terminal_leaves_ffmpeg_to_the_command(tmp_path: Path) -> None:
    process = filming(tmp_path)
    assert os.getpgid(ffmpeg_of(process)) != process.pid, "it would end first, as if it had failed"
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (130, "")
    assert list(tmp_path.iterdir()) == []


def filming(folder: Path) -> subprocess.Popen[str]:
    """A command that films for long, in a process group of its own; ffmpeg runs."""
    command = [*COMMAND, "blind", "--video", folder / "a.mp4", "--seconds", "3600", "--size", "64x64"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, process_group=0)
    deadline = time.monotonic() + 200
    while ffmpeg_of(process) is None:
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.1)
    return process


def ffmpeg_of(process: subprocess.Popen[str]) -> int | None:
    """The child that writes the video; None: there is none yet. The package asks another for its version."""
    with suppress(psutil.Error):
        for child in psutil.Process(process.pid).children():
            if "rawvideo" in child.cmdline():
                return child.pid
    return None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"video": Path("a.avi")}, r"--video a.avi: should end in .mp4"),
        ({"size": "1280"}, r"--size 1280: should be WIDTHxHEIGHT, both even and from 64 to 4096"),
        ({"size": "65x64"}, r"--size 65x64: should be WIDTHxHEIGHT, both even"),
        ({"size": "64x9000"}, r"--size 64x9000: should be WIDTHxHEIGHT, both even"),
        ({"town": "town99"}, r"--town town99: there is no town named 'town99'"),
        ({"policy": "rule-bsed"}, r"^rule-bsed: there is no such file, .*did you mean rule-based\?"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    options: dict[str, object], message: str, tmp_path: Path
) -> None:
    given = {"policy": "blind", "video": tmp_path / "a.mp4", "town": "town02", "size": "64x64", **options}
    with pytest.raises(CommandError, match=message) as error:
        record(**given)
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []
