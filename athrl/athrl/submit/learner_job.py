"""The learner's job, as its run's folder and Slurm know it: the names of a run's jobs, and why none runs."""

from __future__ import annotations

from collections import deque
from pathlib import Path

from athrl_protocol.announcements.address_file import ADDRESS_FILE

from athrl.errors import CommandError
from athrl.submit import slurm

SCRIPTS = "slurm"
"""Folder in a run's folder with the scripts of its jobs."""

LOGS = "logs"

JOBS = ("learner", "evaluator", "actors")


def job_name(run: str, job: str) -> str:
    """Return the name under which Slurm shows a job of a run; no other live run of this user has it."""
    return f"athrl-{run}-{job}"


def was_submitted(folder: Path) -> bool:
    """Return whether the run in a folder was submitted to Slurm."""
    return (folder / SCRIPTS / "learner.sbatch").is_file()


def describe_learner_job(folder: Path) -> str:
    """Return why no learner of a submitted run can be reached; empty if its job runs.

    On a machine without Slurm's commands nothing is known.
    """
    if not slurm.is_here():
        return ""
    name, announced = job_name(folder.name, "learner"), (folder / ADDRESS_FILE).exists()
    try:
        job = next(iter(slurm.jobs_named(name, ended=True)), None)
    except CommandError as error:
        return "" if announced else str(error)
    if announced and (job is None or job.state == "RUNNING"):  # the former may have been given another name
        return ""
    if job is None:
        return f"Slurm has no job {name}{_last_words(folder, '*')}; logs are in {folder / LOGS}"
    if job.state == "RUNNING":
        return f"the learner's job {job} and is starting{_last_words(folder, job.number)}"
    return describe(job, folder) + ("" if job.alive else f"; logs are in {folder / LOGS}")


def describe(job: slurm.Job, folder: Path) -> str:
    """Return in one line what a learner's job does that waits or has ended."""
    if job.alive:
        return f"the learner's job {job}"
    if job.reason == "JobLaunchFailure":
        return (
            f"the learner's job {job}: the node could not write into {folder / LOGS}: "
            "is that on a file system which all nodes share?"
        )
    return f"the learner's job {job}{_last_words(folder, job.number)}"


def _last_words(folder: Path, number: str) -> str:
    """Return the last line of the newest log of a learner's job, to be appended to a sentence."""
    logs = sorted((folder / LOGS).glob(f"learner-{number}.log"), key=lambda path: path.stat().st_mtime)
    if not logs:
        return ""
    with logs[-1].open(errors="replace") as file:
        lines = deque((line.strip() for line in file if line.strip()), maxlen=1)
    return f", its log ends with: {lines[0].removeprefix('athrl: ')}" if lines else ""
