"""A run of a study ends in time, says why it failed, and never meets another process in its folder."""

from __future__ import annotations

import fcntl
import threading
from collections.abc import Sequence
from pathlib import Path

import pytest
from athrl.ports import free_address
from athrl.study.runs import RunFailed, Stopped, train, train_words
from athrl.study.scores import scores_said


def trained(folder: Path, words: Sequence[str], stop: threading.Event | None = None, **limits: float) -> None:
    """Let `athrl` do something in the place of a run."""
    limits = {"limit_seconds": 200.0, **limits}
    train(folder / "run", lambda: words, 10, folder / "run.log", stop or threading.Event(), **limits)


def test_run_that_takes_longer_than_it_may_has_failed(tmp_path: Path, address: str) -> None:
    endless = ["router", "--listen", address]
    with pytest.raises(RunFailed, match=r"did not end within 0 h: see .*run.log"):
        trained(tmp_path, endless, limit_seconds=0.0)


def test_failed_run_gives_the_commands_own_line(tmp_path: Path) -> None:
    with pytest.raises(RunFailed, match=r"^ended with code 2: .*--policy"):
        trained(tmp_path, ["evaluate"])


def test_run_waits_for_the_command_of_a_study_that_was_killed(tmp_path: Path) -> None:
    stop, asked = threading.Event(), list[str]()

    def words() -> list[str]:
        asked.append("started")
        return ["--version"]

    with (tmp_path / "run.lock").open("ab") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        threading.Timer(1.0, stop.set).start()
        with pytest.raises(Stopped):
            train(tmp_path / "run", words, 10, tmp_path / "run.log", stop, limit_seconds=200.0)
    assert not asked
    train(tmp_path / "run", words, 10, tmp_path / "run.log", threading.Event(), limit_seconds=200.0)
    assert asked


def test_run_that_is_there_is_resumed_with_the_settings_it_has(tmp_path: Path) -> None:
    address = free_address()
    new = train_words(tmp_path / "run", ["learner.batch=64"], address=address)
    assert {"--name", "learner.batch=64", f"network.listen={address}"} <= set(new)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.toml").write_text("")
    again = train_words(tmp_path / "run", ["learner.batch=64"], address=address)
    assert {"--resume", str(tmp_path / "run"), f"network.listen={address}"} <= set(again)
    assert "learner.batch=64" not in again


def test_scores_are_found_among_other_lines() -> None:
    assert scores_said(["loading", '{"return_mean": 1.5}', "a warning"]) == {"return_mean": 1.5}
    with pytest.raises(RunFailed, match="printed no scores"):
        scores_said(["loading"])
    for damaged in ('{"return_mean": 1.', '{"return_mean": null}'):
        with pytest.raises(RunFailed, match="printed no scores: "):
            scores_said([damaged])
