"""A run as jobs of a real Slurm: it trains, its jobs come and go, nothing that was acknowledged is lost.

The tests share one cluster and one run, in the order in which they stand here.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from athrl.certificate_files import names_in

from tests.chaos.audit import compare, imbalances, read_log
from tests.chaos.evidence import Evidence
from tests.slurm.cluster import Cluster

ROOT = Path(__file__).parents[2]
RUN = "field"
ACTORS = 2
STARTED_SECONDS = 150.0
"""For a service's first start here: actors may have to compile the simulation."""
REQUEUED_SECONDS = 90.0

# An endless run that is small enough for two cores, and keeps its whole log.
SETTINGS = {
    "run.environment_steps": 10_000_000,
    "environment.vehicles": 10,
    "environment.episode_ticks": 120,
    "exploration.random_decisions": 100,
    "planner.hidden_features": 16,
    "planner.head_features": 16,
    "replay.capacity": 100_000,
    "learner.batch": 40,
    "learner.samples_per_insert": 4.0,
    "learner.publish_seconds": 1.0,
    "learner.checkpoint_seconds": 5.0,
    "actor.environments": 2,
    "evaluator.episodes": 2,
    "evaluator.final_episodes": 2,
    "evaluator.seconds_between": 2.0,
}

pytestmark = pytest.mark.timeout(600)


@dataclass
class LoginNode:
    """The command as a user of the cluster types it."""

    cluster: Cluster
    folder: Path

    @property
    def run_folder(self) -> Path:
        return self.folder / "runs" / RUN

    def athrl(self, *words: str, seconds: float = 120.0) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "athrl", *words],
            cwd=self.folder,
            env={**self.cluster.environment, "COLUMNS": "200"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=seconds,
        )

    def submit(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Submit the run with one core for its learner; `words` come last."""
        return self.athrl(
            "submit", "slurm", "run.toml", "--name", RUN, "--cpus", "1", "--actors", str(ACTORS), *words
        )

    def status(self) -> dict[str, Any]:
        """Return the state of the run, empty while its learner is away."""
        done = self.athrl("status", "--connect", str(self.run_folder), "--json")
        assert done.returncode in (0, 2), done.stderr
        return json.loads(done.stdout) if done.returncode == 0 else {}

    def job(self, name: str, form: str) -> str:
        """Return what `squeue` shows of the run's jobs of a kind; tasks of an array on a line each."""
        words = ["--noheader", "--array", f"--name=athrl-{RUN}-{name}", f"--format={form}"]
        return self.cluster.run("squeue", *words).strip()

    def restarts(self, number: str) -> int:
        shown = self.cluster.run("scontrol", "show", "job", number, "--oneliner")
        return int(next(word for word in shown.split() if word.startswith("Restarts=")).partition("=")[2])


@pytest.fixture(scope="module")
def login(cluster: Cluster, free_port: Callable[[], int]) -> LoginNode:
    """A folder that all nodes but the island share, with a run file."""
    folder = cluster.shared
    lines = [f"{key} = {value}" for key, value in SETTINGS.items()]
    (folder / "run.toml").write_text("\n".join([*lines, f'network.listen = "tcp/127.0.0.1:{free_port()}"\n']))
    return LoginNode(cluster, folder)


@pytest.fixture(scope="module")
def evidence(login: LoginNode) -> Evidence:
    """What the actors wrote down."""
    folder = login.folder / "evidence"
    folder.mkdir()
    return Evidence(folder)


@pytest.fixture(scope="module")
def recording(login: LoginNode, evidence: Evidence) -> Path:
    """A program that is athrl, but its actors write down what they make and what is acknowledged."""
    python = shlex.quote(sys.executable)
    path = login.folder / "recording-athrl"
    path.write_text(
        "#!/bin/bash\n"
        f"export PYTHONPATH={shlex.quote(str(ROOT))}\n"
        f'[ "$1" = actor ] || exec {python} -m athrl "$@"\n'
        f"exec {python} -m tests.chaos.recording_actor "
        f'{shlex.quote(str(evidence.folder))}/actor-"$SLURM_ARRAY_TASK_ID".txt "$@"\n'
    )
    path.chmod(0o755)
    return path


@pytest.fixture(scope="module")
def run(login: LoginNode, recording: Path) -> Iterator[LoginNode]:
    """The run in Slurm's queue, its actors in a partition whose jobs may be preempted."""
    done = login.submit("--program", str(recording), "--actor-sbatch=--partition=preemptible")
    assert done.returncode == 0, done.stderr
    yield login
    login.athrl("submit", "slurm", "--cancel", str(login.run_folder))


def wait(what: str, condition: Callable[[], object], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"{what}: not within {seconds} s"
        time.sleep(0.5)


def await_all_actors(evidence: Evidence, since: float, seconds: float) -> None:
    """Wait until each task of the array has a chunk acknowledged that is newer than `since`."""

    def delivered() -> bool:
        evidence.read()
        newest = {
            path.name: any(
                float(line.split()[1]) > since
                for line in path.read_text().splitlines()
                if line.startswith("acknowledged")
            )
            for path in evidence.folder.glob("*.txt")
        }
        return len(newest) == ACTORS and all(newest.values())

    wait(f"new chunks of all actors in {evidence.folder}", delivered, seconds)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--partition", "nope"], "invalid partition specified: nope"),
        (["--cpus", "64"], "Requested node configuration is not available"),
        (["--time", "2-00:00:00"], "PENDING (PartitionTimeLimit) and would stay so"),
        (["--partition", "island"], "is that on a file system which all nodes share?"),
        (["--program", "/nowhere/athrl"], "/nowhere/athrl: No such file or directory"),
    ],
)
def test_jobs_that_cannot_start_are_one_line_and_nothing_is_left(
    login: LoginNode, words: list[str], said: str
) -> None:
    done = login.submit(*words)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert said in done.stderr
    assert not login.run_folder.exists()
    assert not login.job("learner", "%i")


def test_learner_that_waits_for_its_turn_is_explained(login: LoginNode) -> None:
    done = login.submit("--partition", "closed")
    assert "PENDING (PartitionDown)" in done.stderr
    status = login.athrl("status", "--connect", str(login.run_folder))
    assert (status.returncode, status.stderr.count("\n")) == (2, 1)
    assert "PENDING (PartitionDown)" in status.stderr
    again = login.submit()
    assert again.returncode == 2
    assert "is in Slurm's queue already" in again.stderr
    assert login.athrl("submit", "slurm", "--cancel", RUN).returncode == 0
    assert not login.job("learner,athrl-field-actors,athrl-field-evaluator", "%i")


def test_jobs_start_and_train_with_certificates(run: LoginNode, evidence: Evidence) -> None:
    await_all_actors(evidence, 0.0, STARTED_SECONDS)
    wait("updates and a score", lambda: run.status().get("evaluations"), STARTED_SECONDS)
    status = run.status()
    assert status["updates"] > 0
    assert sorted(status["actors"]) == ["actor-1", "actor-2"]
    assert (run.run_folder / "learner.address").read_text().startswith("tls/127.0.0.1")


def test_login_node_watches_an_episode(run: LoginNode, free_port: Callable[[], int]) -> None:
    words = ["watch", "--connect", str(run.run_folder), "--serve", str(free_port())]
    said = run.folder / "watch.log"
    with said.open("w") as output:
        watching = subprocess.Popen(
            [sys.executable, "-m", "athrl", *words], env=run.cluster.environment, stdout=output, stderr=output
        )
    try:
        wait("a viewer", lambda: "watching evaluator" in said.read_text(), STARTED_SECONDS)
    finally:
        watching.terminate()
    assert watching.wait(30) == 0


def test_cancelled_and_requeued_actor_delivers_again(run: LoginNode, evidence: Evidence) -> None:
    array = run.job("actors", "%F").splitlines()[0]
    run.cluster.run("scancel", f"{array}_1")
    wait("the end of the task", lambda: f"{array}_1" not in run.job("actors", "%i"), REQUEUED_SECONDS)
    since = time.monotonic()
    run.cluster.run("scontrol", "requeue", f"{array}_1")
    await_all_actors(evidence, since, REQUEUED_SECONDS)


def test_preempted_actors_deliver_again(run: LoginNode, evidence: Evidence) -> None:
    urgent = run.cluster.run(
        "sbatch", "--parsable", "--partition=urgent", "--exclusive", "--output=/dev/null", "--wrap=sleep 3"
    ).strip()
    wait("preemption", lambda: "R" not in run.job("actors", "%t").split(), REQUEUED_SECONDS)
    since = time.monotonic()
    wait(
        "the urgent job", lambda: not run.cluster.run("squeue", "-h", "-j", urgent).strip(), REQUEUED_SECONDS
    )
    await_all_actors(evidence, since, REQUEUED_SECONDS)
    assert all(run.restarts(number) for number in run.job("actors", "%A").split())


def test_learner_at_its_time_limit_requeues_itself_on_another_node(
    run: LoginNode, evidence: Evidence
) -> None:
    number, before = run.job("learner", "%A"), run.status()
    was = run.job("learner", "%N")
    run.cluster.run("scontrol", "update", f"NodeName={was}", "State=DRAIN", "Reason=test")
    # What --signal=B:USR1@120 sends before the time limit; waiting for one would take minutes.
    run.cluster.run("scancel", "--batch", "--signal=USR1", number)
    wait("the learner's end", lambda: run.job("learner", "%t") != "R", REQUEUED_SECONDS)
    since = time.monotonic()
    await_all_actors(evidence, since, REQUEUED_SECONDS)
    run.cluster.run("scontrol", "update", f"NodeName={was}", "State=RESUME")
    status, address = run.status(), (run.run_folder / "learner.address").read_text()
    assert run.job("learner", "%A %N") == f"{number} {'n2' if was == 'n1' else 'n1'}"
    assert run.restarts(number) == 1
    assert status["environment_steps"] > before["environment_steps"]
    assert address.split("/")[1].split(":")[0] in names_in(run.run_folder / "certificates/learner/tls.crt")


def test_killed_and_requeued_learner_resumes(run: LoginNode, evidence: Evidence) -> None:
    number, before = run.job("learner", "%A"), run.status()
    run.cluster.run("scancel", "--full", "--signal=KILL", number)
    wait("the learner's end", lambda: run.job("learner", "%t") != "R", REQUEUED_SECONDS)
    run.cluster.run("scontrol", "requeue", number)
    await_all_actors(evidence, time.monotonic(), REQUEUED_SECONDS)
    assert run.status()["environment_steps"] >= before["environment_steps"]


def test_cancelling_leaves_nothing_behind_and_loses_nothing(run: LoginNode, evidence: Evidence) -> None:
    done = run.athrl("submit", "slurm", "--cancel", str(run.run_folder))
    assert done.returncode == 0, done.stderr
    assert not run.job("learner,athrl-field-actors,athrl-field-evaluator", "%i")
    wait("the end of all processes", lambda: not run.cluster.processes_of_jobs(), 30.0)
    assert not (run.run_folder / "learner.address").exists()
    assert not list(run.run_folder.rglob("*.part"))
    evidence.read()
    log = read_log(run.run_folder / "experience")
    account = compare(evidence, log)
    assert account.acknowledged > 0
    assert (account.lost, account.twice, account.foreign, log.problems) == (0, 0, 0, [])
    assert not imbalances(evidence, log, run.run_folder / "checkpoints", [])


def test_run_that_is_submitted_again_continues_and_its_jobs_leave_when_it_is_finished(
    login: LoginNode,
) -> None:
    facts = login.run_folder / "policies" / "latest.json"
    wanted = json.loads(facts.read_text())["environment_steps"] + 2_000
    # The third task waits, as the partition has room for two.
    done = login.submit(
        "--set", f"run.environment_steps={wanted}", "--actors", "3", "--actor-sbatch=--partition=preemptible"
    )
    assert done.returncode == 0, done.stderr
    jobs = "learner,athrl-field-actors,athrl-field-evaluator"
    wait("an empty queue", lambda: not login.job(jobs, "%i"), STARTED_SECONDS)
    assert json.loads(facts.read_text())["environment_steps"] >= wanted
    assert (login.run_folder / "evaluation.json").exists()
    assert not login.cluster.processes_of_jobs()
