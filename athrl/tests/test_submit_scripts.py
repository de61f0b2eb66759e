"""What the scripts of a run's jobs do, run by bash with stand-ins for athrl and for Slurm's commands."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from athrl.submit.scripts import Request, Run, make_scripts

SECONDS = 120.0

STAND_IN = """\
#!/bin/bash
echo "${0##*/} $*" >>"$CALLS"
case "${0##*/}" in
scontrol) echo 'NodeName=n1 NodeAddr=10.0.0.1 NodeHostName=n1' ;;
squeue) echo "$QUEUE" ;;
esac
"""

SERVICE = """\
#!/bin/bash
echo "athrl $*" >>"$CALLS"
[ "$1" != certificates ] || exit 0
trap 'echo drained >>"$CALLS"; exit 0' TERM
count=$(grep -c -E '^athrl (learner|actor|evaluator)' "$CALLS")
set -- $CODES
code=${!count}
[ "$code" != wait ] || { echo ready >>"$CALLS"; while :; do sleep 0.05; done; }
exit "$code"
"""


@dataclass
class Node:
    """A machine with stand-ins: the service ends with the next of `codes`, or waits for a signal."""

    folder: Path
    codes: str = "0"
    queue: str = ""
    seconds: int = 1000
    scripts: dict[str, str] = field(default_factory=dict)

    @property
    def calls(self) -> list[str]:
        """What was called, in order."""
        path = self.folder / "calls"
        return path.read_text().splitlines() if path.exists() else []

    def start(self, job: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            ["bash", "-c", self.scripts[job]],
            env={
                "PATH": f"{self.folder / 'bin'}:{os.environ['PATH']}",
                "CALLS": str(self.folder / "calls"),
                "CODES": self.codes,
                "QUEUE": self.queue,
                "SECONDS": str(self.seconds),  # since when bash counts
                "SLURM_JOB_ID": "12",
                "SLURMD_NODENAME": "n1",
            },
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, job: str) -> tuple[int, str]:
        """Run a job's script to its end; return its code and what it said."""
        with self.start(job) as process:
            _, said = process.communicate(timeout=SECONDS)
        return process.returncode, said

    def await_call(self, words: str) -> None:
        deadline = time.monotonic() + SECONDS
        while words not in self.calls:
            assert time.monotonic() < deadline, self.calls
            time.sleep(0.02)


@pytest.fixture
def node(tmp_path: Path) -> Node:
    place, run_folder = tmp_path / "bin", tmp_path / "my runs" / "town03"
    place.mkdir()
    (run_folder / "slurm").mkdir(parents=True)
    for name in ("scontrol", "squeue", "scancel"):
        (place / name).write_text(STAND_IN)
    (place / "athrl").write_text(SERVICE)
    for path in place.iterdir():
        path.chmod(0o755)
    run = Run(run_folder, [str(place / "athrl")], ["--set", 'run.name="town03"'], tmp_path)
    request = Request(3, 4, "a100:1", ["--partition=main"], ["--mem=8G"], ["--qos low --nice"])
    return Node(tmp_path, scripts=make_scripts(run, request))


def test_every_script_asks_for_what_was_asked(node: Node) -> None:
    heads = {
        job: [line.removeprefix("#SBATCH ") for line in text.splitlines() if line.startswith("#SBATCH")]
        for job, text in node.scripts.items()
    }
    for job, lines in heads.items():
        assert f"--job-name=athrl-town03-{job}" in lines
        assert {"--requeue", "--open-mode=append", "--partition=main"} <= set(lines)
        assert any(line.startswith(f'--output="{node.folder}/my runs/town03/logs/{job}-%') for line in lines)
    assert {"--cpus-per-task=4", "--gpus=a100:1", "--mem=8G"} <= set(heads["learner"])
    assert {"--array=1-3", "--cpus-per-task=1", "--qos low --nice"} <= set(heads["actors"])
    assert not any("gpus" in line for line in heads["actors"] + heads["evaluator"])


def test_learner_is_started_with_a_certificate_for_its_node(node: Node) -> None:
    assert node.run("learner") == (0, "")
    folder = f"{node.folder}/my runs/town03"
    assert node.calls[1:3] == [
        f"athrl certificates {folder}/certificates --if-missing --names 10.0.0.1",
        f'athrl learner --resume-if-present --set run.name="town03" --certificates {folder}/certificates '
        "--reached-as 10.0.0.1",
    ]


def test_finished_learner_cancels_actors_that_wait(node: Node) -> None:
    assert node.run("learner") == (0, "")
    assert node.calls[3:] == [f"scancel --user={os.getuid()} --name=athrl-town03-actors --state=PENDING"]


def test_learner_that_fails_for_good_cancels_all_that_need_it(node: Node) -> None:
    node.codes = "2"
    assert node.run("learner") == (2, "")
    assert node.calls[3:] == [
        f"scancel --user={os.getuid()} --name=athrl-town03-{job}" for job in ("actors", "evaluator")
    ]


def test_service_that_dies_is_started_again(node: Node) -> None:
    node.codes = "139 0"
    assert node.run("actors") == (0, "athrl: ended with code 139; restarting it\n")
    assert len(node.calls) == 2


@pytest.mark.parametrize("job", ["learner", "evaluator", "actors"])
def test_job_at_its_time_limit_drains_and_requeues_itself(node: Node, job: str) -> None:
    node.codes = "wait"
    with node.start(job) as process:
        node.await_call("ready")
        process.send_signal(signal.SIGUSR1)
        assert process.wait(SECONDS) == 0
    assert node.calls[-2:] == ["drained", "scontrol requeue 12"]


@pytest.mark.parametrize("number", [signal.SIGUSR1, signal.SIGTERM])
def test_job_that_is_to_end_between_two_attempts_starts_no_third(node: Node, number: signal.Signals) -> None:
    node.codes = "1 1 0"
    started = f"athrl actor --connect {node.folder}/my runs/town03"
    with node.start("actors") as process:
        deadline = time.monotonic() + SECONDS
        while sum(call.startswith(started) for call in node.calls) < 2:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        time.sleep(0.5)  # it has ended, and there are three seconds until the next
        process.send_signal(number)
        process.communicate(timeout=SECONDS)
    assert sum(call.startswith(started) for call in node.calls) == 2
    assert ("scontrol requeue 12" in node.calls) == (number == signal.SIGUSR1)


def test_too_short_a_time_limit_does_not_requeue_for_ever(node: Node) -> None:
    node.codes, node.seconds = "wait", 0
    with node.start("actors") as process:
        node.await_call("ready")
        process.send_signal(signal.SIGUSR1)
        _, said = process.communicate(timeout=SECONDS)
    assert process.returncode == 2
    assert "is the time limit too short?" in said
    assert node.calls[-1] == "drained"


@pytest.mark.parametrize("job", ["learner", "actors"])
def test_job_that_slurm_ends_drains_once_and_leaves_the_rest_to_slurm(node: Node, job: str) -> None:
    node.codes = "wait"
    with node.start(job) as process:
        node.await_call("ready")
        children = subprocess.run(
            ["pgrep", "-P", str(process.pid)], capture_output=True, text=True, check=True
        )
        for number in [process.pid, *map(int, children.stdout.split())]:  # Slurm signals every process
            os.kill(number, signal.SIGTERM)
        assert process.wait(SECONDS) == 0
    assert node.calls[-1] == "drained"


def test_actor_without_a_learner_makes_room_for_it_while_it_waits(node: Node) -> None:
    node.codes, node.queue = "75", "12"
    assert node.run("actors") == (0, "")
    assert node.calls[-1] == "scontrol requeue 12"


def test_actor_without_a_learner_ends_when_that_has_no_job(node: Node) -> None:
    node.codes = "75"
    assert node.run("actors") == (75, "")
    assert node.calls[-1].startswith("squeue")


def test_node_that_does_not_share_the_folder_says_so(node: Node) -> None:
    (node.folder / "my runs" / "town03" / "slurm").rmdir()
    code, said = node.run("actors")
    assert code == 2
    assert "the run's folder has to be on a file system that all nodes share" in said
    assert node.calls == []
