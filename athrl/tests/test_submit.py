"""`athrl submit slurm`: what it refuses before Slurm is asked, and what it says of Slurm's answers."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from athrl.errors import CommandError
from athrl.submit import slurm
from athrl.submit.command import submit
from athrl.submit.learner_job import describe_learner_job


def put(folder: Path, name: str, body: str) -> None:
    """Put a stand-in for a command of Slurm into a folder."""
    path = folder / name
    path.write_text(f"#!/bin/bash\n{body}\n")
    path.chmod(0o755)


@pytest.fixture
def commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder on the PATH with stand-ins for Slurm's commands, which do nothing."""
    place = tmp_path / "bin"
    place.mkdir()
    for name in slurm.COMMANDS:
        put(place, name, "")
    monkeypatch.setenv("PATH", f"{place}:{os.environ['PATH']}")
    return place


def test_machine_without_slurm_is_told_in_one_line_and_nothing_is_written(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "athrl", "submit", "slurm", "--actors", "4"],
        cwd=tmp_path,
        env={**os.environ, "PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "athrl: there is no Slurm on this machine, sbatch is not on the PATH: run this on a login node\n"
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"settings": ["serial.enabled=true"]}, "a serial run is one process"),
        ({"settings": ["network.certificates=mine"]}, "network.certificates is mine: a submitted"),
        ({"partition": "a b"}, "--partition 'a b': should be one word"),
        ({"time": "1\n#SBATCH -x"}, "should be one word"),
        ({"sbatch": ["8G"]}, "--sbatch '8G': should be sbatch's options"),
        ({"actor_sbatch": ["--x\nrm"]}, "--actor-sbatch '--x"),
        ({"program": "a 'b"}, "no closing quotation"),
        ({"program": " "}, "--program ' ': should be a command"),
        ({"name": "a/b"}, "--name a/b"),
        ({"cancel": "town03"}, "the run town03 has no jobs in Slurm's queue"),
    ],
)  # fmt: skip
def test_wrong_request_is_one_line(
    commands: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: dict[str, object], said: str
) -> None:
    place = tmp_path / "work"
    place.mkdir()
    monkeypatch.chdir(place)
    with pytest.raises(CommandError) as error:
        submit("slurm", **{"settings": ["environment.vehicles=5"], **arguments})  # type: ignore[arg-type]
    assert said in str(error.value)
    assert list(place.iterdir()) == []


def test_slurm_that_does_not_answer_is_one_line(commands: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(commands, "squeue", "sleep 60")
    monkeypatch.setattr(slurm, "ANSWER_SECONDS", 0.2)
    with pytest.raises(CommandError, match=r"squeue did not answer within 0\.2 s: is its controller up\?"):
        slurm.jobs_named("athrl-town03-learner")


def test_slurm_that_refuses_is_quoted_in_one_line(commands: Path) -> None:
    put(
        commands,
        "sbatch",
        "echo -e 'sbatch: error: no\\nsbatch: error: no\\nsbatch: error: never' >&2; exit 1",
    )
    with pytest.raises(CommandError, match=r"^Slurm: no; never$"):
        slurm.check("#!/bin/bash\n")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("12|PENDING|Resources|", "the learner's job 12 is PENDING (Resources)"),
        ("12|RUNNING|None|n7", "the learner's job 12 is RUNNING on n7 and is starting"),
        ("12|FAILED|NonZeroExitCode|n7", "is FAILED on n7 (NonZeroExitCode), its log ends with: it is full;"),
        ("12|FAILED|JobLaunchFailure|n7", "is that on a file system which all nodes share?"),
        ("", "Slurm has no job athrl-town03-learner, its log ends with: it is full;"),
    ],
)
def test_absence_of_a_learner_is_explained_by_its_job(
    commands: Path, tmp_path: Path, line: str, said: str
) -> None:
    folder = tmp_path / "town03"
    (folder / "logs").mkdir(parents=True)
    if "RUNNING" not in line:
        (folder / "logs" / "learner-12.log").write_text("starting\nathrl: it is full\n\n")
    put(commands, "squeue", f"echo '{line}'")
    assert said in describe_learner_job(folder)
    assert "\n" not in describe_learner_job(folder)


@pytest.mark.parametrize("line", ["12|RUNNING|None|n7", ""])
def test_learner_that_runs_needs_no_explanation(commands: Path, tmp_path: Path, line: str) -> None:
    (tmp_path / "learner.address").write_text("tls/n7:7447\n")
    put(commands, "squeue", f"echo '{line}'")
    assert describe_learner_job(tmp_path) == ""
