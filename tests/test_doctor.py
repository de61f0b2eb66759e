"""`athrl doctor` names what is wrong, says what to do, and its exit code tells whether a run would work."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

SECONDS = 200.0
pytestmark = pytest.mark.timeout(500)

Report = dict[str, Any]


@pytest.fixture
def doctor(command, port: int):
    """Asks the doctor about a run that would listen at `port`; returns exit code and report."""

    def ask(*arguments: str) -> tuple[int, Report]:
        listen = ["--set", f"network.listen=tcp/127.0.0.1:{port}"]
        result = command.run("doctor", "--json", *listen, *arguments, seconds=SECONDS)
        assert not result.stderr, result.stderr
        return result.returncode, json.loads(result.stdout)

    return ask


def of(report: Report, check: str) -> dict[str, str]:
    """The only finding of a check."""
    (found,) = (finding for finding in report["checks"] if finding["check"] == check)
    return found


def test_sound_installation_passes_and_loses_nothing(doctor) -> None:
    code, report = doctor()
    assert code == 0, report
    assert report["ok"]
    assert report["failed"] == 0
    assert (
        "3000 chunks acknowledged over a kill of the receiver, lost 0, twice 0"
        in of(report, "delivery")["seen"]
    )
    for check in ("python", "services", "memory", "run folder", "disk", "fsync", "simulation", "port"):
        assert of(report, check)["level"] in ("ok", "warning")


def test_port_in_use_and_replay_beyond_the_memory_are_named_with_what_to_do(doctor, port: int) -> None:
    with socket.create_server(("127.0.0.1", port)):
        code, report = doctor("--set", "replay.capacity=10000000000")
    assert code == 1
    assert report["failed"] == 2
    assert of(report, "port")["level"] == "failed"
    assert f"127.0.0.1:{port} is in use" in of(report, "port")["seen"]
    assert of(report, "port")["remedy"]
    assert of(report, "memory")["level"] == "failed"
    assert "replay.capacity" in of(report, "memory")["remedy"]


@pytest.fixture
def full_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk without room; skips where this user may mount none."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = [shutil.which("mount") or "false", "-t", "tmpfs", "-o", "size=1m", "tmpfs", folder]
    if subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("this user may not mount a file system")
    with (folder / "ballast").open("wb", buffering=0) as ballast:
        try:
            while True:
                ballast.write(bytes(2**16))
        except OSError:
            pass
    yield folder
    subprocess.run(["umount", folder], check=True)


def test_full_disk_is_named(doctor, full_disk: Path) -> None:
    code, report = doctor("--set", f"run.folder={full_disk}")
    assert code == 1
    assert of(report, "run folder")["level"] == "failed"
    assert str(full_disk) in of(report, "run folder")["seen"]
    assert "run.folder" in of(report, "run folder")["remedy"]
    assert of(report, "delivery")["seen"].startswith(f"not tested: {full_disk}")


def test_absent_learner_is_one_failed_line_also_where_output_is_ascii(
    command, port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    result = command.run("doctor", "--connect", f"tcp/127.0.0.1:{port}", seconds=SECONDS)
    assert result.returncode == 1, result.stderr
    lines = [line for line in result.stdout.splitlines() if line.startswith("failed")]
    assert len(lines) == 1
    assert f"no learner at tcp/127.0.0.1:{port}" in lines[0]
    assert result.stdout.splitlines()[-1].endswith("1 failed")


def test_live_run_is_described(command, doctor, tiny: list[str], port: int) -> None:
    learner = command.start("learner", *tiny, "--set", "run.name=patient")
    command.wait_until_said(learner, "listens at", SECONDS)
    code, report = doctor("--connect", f"tcp/127.0.0.1:{port}", "--run", "patient")
    assert code == 0, report
    assert "run patient" in of(report, "release")["seen"]
    assert of(report, "present")["level"] == "warning"
    assert "no actor is running" in of(report, "present")["remedy"]
    assert "warming up" in of(report, "state")["seen"]
    for check in ("learner", "round trip", "clock", "policy lag"):
        assert of(report, check)["level"] == "ok", report
    assert "port" not in [finding["check"] for finding in report["checks"]]
    code, report = doctor("--connect", f"tcp/127.0.0.1:{port}", "--run", "another")
    assert code == 1
    (wrong,) = (finding for finding in report["checks"] if finding["level"] == "failed")
    assert "patient" in wrong["seen"]


def test_wrong_setting_is_the_commands_own_error(command) -> None:
    result = command.run("doctor", "--set", "learner.bach=3", seconds=SECONDS)
    assert result.returncode == 2
    assert "learner.bach" in result.stderr
    assert len(result.stderr.splitlines()) == 1
