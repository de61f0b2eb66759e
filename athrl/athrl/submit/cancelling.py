"""Cancelling the jobs of a run: the learner last, so that it receives what the others still hold."""

from __future__ import annotations

import time

from athrl_spaces.wording import counted

from athrl.errors import CommandError, say
from athrl.submit import slurm
from athrl.submit.learner_job import job_name

CLIENT_SECONDS = 60.0
LEARNER_SECONDS = 90.0
"""Limits for jobs to be gone: Slurm kills what is still there after its KillWait, 30 s by default."""
POLL_SECONDS = 1.0


def cancel_run(run: str) -> None:
    """Cancel all jobs of a run and wait until they are gone.

    Raises:
        CommandError: there are none, or some are not gone in time.
    """
    slurm.require_slurm()
    learner, *clients = (job_name(run, job) for job in ("learner", "actors", "evaluator"))
    count = len(slurm.jobs_named(learner, *clients))
    if not count:
        raise CommandError(f"the run {run} has no jobs in Slurm's queue")
    _cancel(clients, CLIENT_SECONDS)
    _cancel([learner], LEARNER_SECONDS)
    say(f"run {run}: {counted(count, 'job')} cancelled and gone; to continue it: submit it again")


def _cancel(names: list[str], seconds: float) -> None:
    slurm.cancel(*names)
    deadline = time.monotonic() + seconds
    while jobs := slurm.jobs_named(*names):
        if time.monotonic() > deadline:
            raise CommandError(f"cancelled, but not gone within {seconds:g} s: job {jobs[0]}")
        time.sleep(POLL_SECONDS)
