"""A video has the length and the size that were asked for, and is whole or not there."""

from __future__ import annotations

import subprocess
import threading
from itertools import pairwise
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from athrl_evaluator import video
from athrl_evaluator.errors import EvaluatorError
from athrl_evaluator.policies.shipped import shipped_policy
from athrl_evaluator.scoring.episodes import Stopped
from athrl_evaluator.video import Shot, film

SHOT = Shot("town02", vehicles=100, seed=3, seconds=2.0, size=(160, 96))


def pictures(path: Path) -> list[np.ndarray]:
    """Decode a video: uint8 [height, width, 3] each."""
    reader = imageio_ffmpeg.read_frames(path)
    width, height = next(reader)["size"]
    return [np.frombuffer(picture, np.uint8).reshape(height, width, 3) for picture in reader]


@pytest.mark.parametrize("driver", ["rule-based", "policy"])
def test_a_driver_is_filmed_tick_by_tick_in_real_time(driver: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    who = shipped_policy("town03") if driver == "policy" else driver
    assert film(who, SHOT, path, threading.Event()) == 20
    facts = next(imageio_ffmpeg.read_frames(path))
    assert (facts["fps"], facts["size"], facts["codec"]) == (10.0, SHOT.size, "h264")
    assert facts["pix_fmt"].startswith("yuv420p"), "all players show it"
    shown = pictures(path)
    assert len(shown) == 20
    assert all(np.abs(a.astype(int) - b).max() > 20 for a, b in pairwise(shown[8:]))
    assert [each.name for each in tmp_path.iterdir()] == ["a.mp4"]


def test_an_episode_that_ends_is_followed_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seeds, reset = [], video.TownEnv.reset

    def noted_reset(self: video.TownEnv, *, seed: int | None = None, **options: object) -> tuple:
        seeds.append(seed)
        return reset(self, seed=seed, **options)

    monkeypatch.setattr(video.TownEnv, "reset", noted_reset)
    shot = Shot("town02", vehicles=100, seed=3, seconds=20.0, size=(64, 64))
    assert film("random", shot, tmp_path / "a.mp4", threading.Event()) == 200
    driven = [seed for seed in seeds if seed is not None]
    assert len(driven) > 1
    assert driven == list(range(3, 3 + len(driven)))


def test_a_video_that_is_not_completed_in_time_leaves_nothing_and_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = tmp_path / "ffmpeg"
    endless.write_text("#!/bin/sh\ncat > /dev/null\nexec sleep 200\n")
    endless.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(endless))
    monkeypatch.setattr(video, "FINISH_SECONDS", 0.2)
    refused = pytest.raises(EvaluatorError, match=r"a.mp4: ffmpeg does not complete it within 0.2 s$")
    with refused, video._written(tmp_path / "a.mp4", (64, 64), 10.0, overwrite=False) as write:
        write(np.zeros((64, 64, 3), np.uint8))
    assert list(tmp_path.iterdir()) == [endless]


def test_a_picture_that_ffmpeg_does_not_take_in_time_leaves_nothing_and_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    idle = tmp_path / "ffmpeg"
    idle.write_text("#!/bin/sh\nexec sleep 200\n")
    idle.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(idle))
    monkeypatch.setattr(video, "STALL_SECONDS", 0.2)
    refused = pytest.raises(EvaluatorError, match=r"a.mp4: ffmpeg takes no picture within 0.2 s$")
    with refused, video._written(tmp_path / "a.mp4", (256, 256), 10.0, overwrite=False) as write:
        write(np.zeros((256, 256, 3), np.uint8))
    assert list(tmp_path.iterdir()) == [idle]


def test_ffmpeg_that_does_not_end_though_it_is_killed_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[subprocess.Popen] = []
    kill = subprocess.Popen.kill
    idle = tmp_path / "ffmpeg"
    idle.write_text("#!/bin/sh\nexec sleep 200\n")
    idle.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(idle))
    monkeypatch.setattr(video, "STALL_SECONDS", 0.2)
    monkeypatch.setattr(video, "END_SECONDS", 0.1)
    monkeypatch.setattr(subprocess.Popen, "kill", lambda self: started.append(self))  # it waits for a disk
    try:
        refused = pytest.raises(EvaluatorError, match=r"a.mp4: ffmpeg takes no picture within 0.2 s$")
        with refused, video._written(tmp_path / "a.mp4", (256, 256), 10.0, overwrite=False) as write:
            write(np.zeros((256, 256, 3), np.uint8))
        assert [each.poll() for each in started] == [None]
    finally:
        for each in started:
            kill(each)
            each.wait(30)


def test_what_is_there_is_only_replaced_when_told_and_by_a_whole_video(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(b"mine")
    with pytest.raises(EvaluatorError, match=r"a.mp4 exists already: name another file, or add --overwrite"):
        film("blind", SHOT, path, threading.Event())
    stop = threading.Event()
    stop.set()
    with pytest.raises(Stopped):
        film("blind", SHOT, path, stop, overwrite=True)
    assert path.read_bytes() == b"mine"
    film("blind", SHOT, path, threading.Event(), overwrite=True)
    assert len(pictures(path)) == 20
    assert [each.name for each in tmp_path.iterdir()] == ["a.mp4"]


def test_a_video_that_cannot_be_written_leaves_nothing_and_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(EvaluatorError, match=r"cannot write .*gone/a.mp4: no such file or directory"):
        film("blind", SHOT, tmp_path / "gone" / "a.mp4", threading.Event())
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/no/such/ffmpeg")
    with pytest.raises(EvaluatorError, match=r"^there is no program /no/such/ffmpeg that can be run: "):
        film("blind", SHOT, tmp_path / "a.mp4", threading.Event())
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/bin/false")  # ends at once
    with pytest.raises(EvaluatorError, match=r"cannot write .*a.mp4: ") as error:
        film("blind", SHOT, tmp_path / "a.mp4", threading.Event())
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []
