"""A disk that gets full during a run: actors wait, the state shows it, and nothing is lost."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from athrl_learner import Summary, run_learner
from athrl_learner.log.disk_space import DiskSpace
from athrl_protocol import RunFile


@pytest.fixture
def small_disk(run_file: RunFile, tmp_path: Path) -> Iterator[RunFile]:
    """The small run, with its folder on a disk of 4 MiB; skips where this user may mount none."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = [shutil.which("mount") or "false", "-t", "tmpfs", "-o", "size=4m", "tmpfs", folder]
    if subprocess.run(command, capture_output=True).returncode:
        pytest.skip("this user may not mount a file system")
    run = run_file.run.model_copy(update={"folder": str(folder), "environment_steps": 2000})
    durability = run_file.durability.model_copy(update={"reserve_mebibytes": 2.0, "segment_mebibytes": 0.02})
    learner = run_file.learner.model_copy(update={"checkpoint_seconds": 1000.0})
    yield run_file.model_copy(update={"run": run, "durability": durability, "learner": learner})
    subprocess.run(["umount", folder], check=True)


def test_a_full_disk_pauses_the_run_until_there_is_space(small_disk, fake_actor, caplog):
    ballast = Path(small_disk.run.folder) / "ballast"
    stop = threading.Event()
    with ThreadPoolExecutor(1) as pool, fake_actor:
        running = pool.submit(run_learner, small_disk, stop=stop)
        try:
            fake_actor.wait_for(lambda: fake_actor.states and fake_actor.states[-1].environment_steps >= 60)
            ballast.write_bytes(bytes(1_900_000))
            fake_actor.wait_for(lambda: "intake is paused" in fake_actor.states[-1].waiting)
            paused_at = fake_actor.states[-1].environment_steps
            states_before = len(fake_actor.states)
            fake_actor.wait_for(lambda: len(fake_actor.states) > states_before + 1)
            assert fake_actor.states[-1].environment_steps == paused_at < 2000
            assert str(small_disk.run.folder) in fake_actor.states[-1].waiting
            assert not running.done()
            ballast.unlink()
            fake_actor.wait_for(lambda: fake_actor.states[-1].environment_steps > paused_at)
            assert "intake pauses, nothing is lost" in caplog.text
            assert "intake continues after" in caplog.text
        finally:
            stop.set()
        summary: Summary = running.result(timeout=60)
    assert summary.environment_steps == 5 * fake_actor.statistics.acknowledged


def test_a_learner_restarts_on_a_full_disk_and_continues_when_there_is_space(small_disk, fake_actor):
    durability = small_disk.durability.model_copy(update={"reserve_mebibytes": 0.5})
    small_disk = small_disk.model_copy(update={"durability": durability})
    ballast = Path(small_disk.run.folder) / "ballast"
    stop = threading.Event()
    with ThreadPoolExecutor(1) as pool, fake_actor:
        first = pool.submit(run_learner, small_disk, stop=stop)
        fake_actor.wait_for(lambda: fake_actor.states and fake_actor.states[-1].environment_steps >= 60)
        stop.set()
        reached = first.result(timeout=60).environment_steps
        with ballast.open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(4096))
        stop = threading.Event()
        second = pool.submit(run_learner, None, resume=Path(small_disk.run.folder) / "small", stop=stop)
        try:
            fake_actor.wait_for(lambda: second.done() or "intake is paused" in fake_actor.states[-1].waiting)
            assert not second.done(), second.result()
            subprocess.run(["mount", "-o", "remount,size=32m", small_disk.run.folder], check=True)
            fake_actor.wait_for(lambda: fake_actor.states[-1].environment_steps > reached)
        finally:
            stop.set()
        assert second.result(timeout=60).environment_steps > reached


def test_what_nobody_waits_for_any_more_is_not_told():
    now = 0.0
    disk_space = DiskSpace(clock=lambda: now)
    assert disk_space.explain() == ""
    disk_space.report_full("the disk is full")
    now = 4.0
    assert disk_space.explain() == "intake is paused for 4 s: the disk is full"
    now = 6.0
    assert disk_space.explain() == ""
    disk_space.report_full("the disk is full")
    assert disk_space.explain() == "intake is paused for 6 s: the disk is full"
    disk_space.report_free()
    assert disk_space.explain() == ""
