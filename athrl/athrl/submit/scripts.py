"""The scripts of a run's jobs: each is complete, for people to read, edit and submit with `sbatch`.

A script is a head of `#SBATCH` lines and values of this run, and the same text for every run, which lies as
`*.sh` beside this file.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from athrl.submit.learner_job import JOBS, LOGS, SCRIPTS, job_name

LEARNER_NOTICE_SECONDS = 120
"""Before the time limit: a learner has 60 s to drain, and then the job requeues itself."""
CLIENT_NOTICE_SECONDS = 60


@dataclass(frozen=True)
class Request:
    """What the jobs of a run ask of Slurm.

    Attributes:
        actors: how many.
        cpus: the learner's cores.
        gpus: the learner's GPUs, as sbatch takes them, such as 1 or a100:1; empty: none.
        every, learner, actor: lines of sbatch's options for all jobs, the learner's, the actors'.
    """

    actors: int
    cpus: int
    gpus: str
    every: Sequence[str]
    learner: Sequence[str]
    actor: Sequence[str]


@dataclass(frozen=True)
class Run:
    """A run to be submitted.

    Attributes:
        folder: its folder, an absolute path.
        program: words of the command that runs athrl on the nodes.
        settings: words of `athrl learner` that say which run it is.
        where: the folder where the jobs run; paths in the settings are relative to it.
    """

    folder: Path
    program: Sequence[str]
    settings: Sequence[str]
    where: Path

    @property
    def jobs(self) -> list[str]:
        """Names of its jobs."""
        return [job_name(self.folder.name, job) for job in JOBS]


def make_scripts(run: Run, request: Request) -> dict[str, str]:
    """Return the text of each job's script by the job: learner, evaluator, actors."""
    learner = [
        "--dependency=singleton",
        f"--cpus-per-task={request.cpus}",
        *([f"--gpus={request.gpus}"] if request.gpus else []),
        *request.learner,
    ]
    actors = [f"--array=1-{request.actors}", "--cpus-per-task=1", *request.actor]
    evaluator = ["--dependency=singleton", "--cpus-per-task=1"]
    drive = {"command": ["actor"]}
    score = {"command": ["evaluator", "--folder", str(run.folder.parent)]}
    return {
        "learner": _script(
            run, "learner", [*request.every, *learner], LEARNER_NOTICE_SECONDS, {"settings": run.settings}
        ),
        "evaluator": _script(run, "evaluator", [*request.every, *evaluator], CLIENT_NOTICE_SECONDS, score),
        "actors": _script(run, "actors", [*request.every, *actors], CLIENT_NOTICE_SECONDS, drive),
    }


def script_path(folder: Path, job: str) -> Path:
    """Return the place of a job's script in the run's folder."""
    return folder / SCRIPTS / f"{job}.sbatch"


def _script(
    run: Run, job: str, options: Sequence[str], notice: int, values: Mapping[str, Sequence[str]]
) -> str:
    log = f"{job}-%A_%a.log" if job == "actors" else f"{job}-%j.log"
    directives = [
        f"--job-name={job_name(run.folder.name, job)}",
        f'--chdir="{run.where}"',
        f'--output="{_without_patterns(run.folder / LOGS)}/{log}"',
        "--open-mode=append",
        "--requeue",
        f"--signal=B:USR1@{notice}",
        *options,
    ]
    others = [other for other in JOBS if other != job and "learner" in (job, other)]
    return "\n".join(
        [
            "#!/bin/bash",
            f"# The {job} of the athrl run {run.folder.name}: athrl submit slurm wrote this.",
            f"# Edit it as you like, and submit it: sbatch {shlex.quote(str(script_path(run.folder, job)))}",
            *(f"#SBATCH {option}" for option in directives),
            "",
            f"run={shlex.quote(str(run.folder))}",
            f"athrl={_array(run.program)}",
            *(f"{name}={_array(words)}" for name, words in values.items()),
            *(f"{other}={shlex.quote(job_name(run.folder.name, other))}" for other in others),
            "",
            _text("service.sh"),
            _text("learner.sh" if job == "learner" else "client.sh"),
        ]
    )


def _without_patterns(path: Path) -> str:
    """Return a path for `--output`, in which sbatch replaces %j and its like."""
    return str(path).replace("%", "%%")


def _array(words: Sequence[str]) -> str:
    return f"({shlex.join(words)})"


def _text(name: str) -> str:
    return (files(__package__) / name).read_text()
