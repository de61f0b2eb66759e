"""A run's folder has one writer and one run."""

import errno
import fcntl
import os
import signal

import pytest
from athrl_learner.errors import LearnerError, RunFolderInUse, RunFolderTaken
from athrl_learner.files import Files, write_whole
from athrl_learner.run_folder import RunFolder


def test_two_learners_never_write_one_folder(tmp_path):
    with RunFolder(tmp_path / "a"):
        with pytest.raises(RunFolderInUse, match="another learner is writing"), RunFolder(tmp_path / "a"):
            pass
        with RunFolder(tmp_path / "b"):
            pass
    with RunFolder(tmp_path / "a"):
        pass


def test_a_killed_learner_leaves_no_lock_behind(tmp_path):
    held, tell = os.pipe()
    holder = os.fork()
    if holder == 0:
        with RunFolder(tmp_path / "run"):
            os.write(tell, b"held")
            signal.pause()
    try:
        assert os.read(held, 4) == b"held"
        with pytest.raises(RunFolderInUse), RunFolder(tmp_path / "run"):
            pass
    finally:
        os.kill(holder, signal.SIGKILL)
        os.waitpid(holder, 0)
    with RunFolder(tmp_path / "run"):
        pass


def test_a_run_that_is_refused_leaves_nothing_behind(tmp_path):
    with pytest.raises(LearnerError, match="refused"), RunFolder(tmp_path / "runs" / "small"):
        raise LearnerError("refused")
    assert list(tmp_path.iterdir()) == []


def test_folders_that_hold_something_or_were_there_stay(tmp_path):
    (tmp_path / "logs" / "logs").mkdir(parents=True)
    (tmp_path / "empty").mkdir()
    for name in ("logs", "empty", "missing"):
        with RunFolder(tmp_path / name):
            pass
    with RunFolder(tmp_path / "run") as folder:
        folder.lay_out("[run]\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "logs", "run"]
    assert (tmp_path / "run" / "run.toml").exists()
    assert [path.name for path in (tmp_path / "logs").iterdir()] == ["logs"]


def test_lock_whose_file_was_removed_meanwhile_is_no_lock(tmp_path, monkeypatch):
    """Another learner that is refused may remove the file after this one has opened it."""
    lock, seen = fcntl.flock, []

    def removed_first(file, how):
        if not seen:
            seen.append(file)
            (tmp_path / "run" / "learner.lock").unlink()
            (tmp_path / "run").rmdir()
        lock(file, how)

    monkeypatch.setattr(fcntl, "flock", removed_first)
    with RunFolder(tmp_path / "run"):
        monkeypatch.undo()
        with pytest.raises(RunFolderInUse), RunFolder(tmp_path / "run"):
            pass


def test_a_new_run_never_overwrites_another(tmp_path):
    with RunFolder(tmp_path / "run") as folder:
        folder.require_unused()
        folder.lay_out("[run]\n")
        with pytest.raises(RunFolderTaken, match="resume it with --resume"):
            folder.require_unused()


def test_logs_of_a_starter_do_not_count_as_a_run(tmp_path):
    (tmp_path / "run" / "logs").mkdir(parents=True)
    with RunFolder(tmp_path / "run") as folder:
        folder.require_unused()


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(LearnerError, match="file/run"), RunFolder(tmp_path / "file" / "run"):
        pass


def test_a_file_is_replaced_whole(tmp_path):
    write_whole(Files(), tmp_path / "policy", b"old")
    write_whole(Files(), tmp_path / "policy", b"new")
    assert [path.name for path in tmp_path.iterdir()] == ["policy"]
    assert (tmp_path / "policy").read_bytes() == b"new"


def test_file_system_without_locks_is_refused_in_one_line(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(LearnerError, match=r"cannot lock .*learner\.lock: no locks available; mount"):
        RunFolder(tmp_path / "run").__enter__()
