"""Submitting a run: checked before anything is written, and taken back if Slurm does not take all of it."""

from __future__ import annotations

import contextlib
import shlex
import shutil
import socket
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

from athrl_spaces.wording import system_reason

from athrl.certificate_files import write_file
from athrl.certificates import complete
from athrl.errors import CommandError
from athrl.rendezvous.run_folder import CERTIFICATES
from athrl.service_names import program
from athrl.submit import slurm
from athrl.submit.learner_job import LOGS, SCRIPTS, describe, job_name
from athrl.submit.scripts import Run, script_path

FIRST_SECONDS = 6.0
"""For so long a learner's job is looked at, since most mistakes end one at once."""
POLL_SECONDS = 0.5
CERTIFICATE_DAYS = 365

NEVER = (
    "BadConstraints",
    "DependencyNeverSatisfied",
    "InvalidAccount",
    "InvalidQOS",
    "PartitionNodeLimit",
    "PartitionTimeLimit",
    "AccountNotAllowed",
    "QOSNotAllowed",
)
"""Reasons of a job that waits and would wait for ever; of others Slurm itself expects that they pass."""


UNDECIDED = ("", "None", "PartitionConfig")
"""Reasons of a job that Slurm has not looked at closely yet."""


class Submission:
    """The scripts of one run on their way into Slurm's queue."""

    def __init__(self, run: Run, scripts: Mapping[str, str], run_file: Path | None) -> None:
        self._run = run
        self._scripts = scripts
        self._run_file = run_file
        self._submitted: dict[str, str] = {}  # job -> number

    def submit(self) -> list[str]:
        """Submit the jobs; return lines for the user.

        Raises:
            CommandError: there is no Slurm, it takes no such jobs, the run is in its queue already, the run's
                folder cannot be written, or the learner's job ended at once or would never start. Then no job
                is left, nor a new folder.
        """
        slurm.require_slurm()
        self._require_not_there()
        for script in self._scripts.values():
            slurm.check(script)
        with ExitStack() as undo:
            self._write(undo)
            undo.callback(self._take_back)
            self._submit_all()
            job = self._first_moments()
            undo.pop_all()
        return self._told(job)

    def _require_not_there(self) -> None:
        jobs = slurm.jobs_named(*self._run.jobs)
        if jobs:
            name = self._run.folder.name
            raise CommandError(
                f"the run {name} is in Slurm's queue already: job {jobs[-1]}: cancel it with "
                f"athrl submit slurm --cancel {name}, or give this run another --name"
            )

    def _write(self, undo: ExitStack) -> None:
        """Write scripts, run file and certificates into the run's folder; a new one goes if this fails."""
        folder = self._run.folder
        new = [place for place in (folder, *folder.parents) if not place.exists()]
        if new:
            undo.callback(_remove, new)
        try:
            given = None if self._run_file is None else self._run_file.read_bytes()
            (folder / LOGS).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CommandError(f"cannot write {folder}: {system_reason(error)}") from None
        for job, script in self._scripts.items():
            write_file(script_path(folder, job), script.encode(), mode=0o755)
        if given is not None:
            write_file(folder / SCRIPTS / "run.toml", given, mode=0o644)
        hosts = ["localhost", socket.gethostname().lower(), "127.0.0.1", "::1"]
        complete(folder / CERTIFICATES, hosts, CERTIFICATE_DAYS)

    def _submit_all(self) -> None:
        for job in self._scripts:
            learner = self._submitted.get("learner")
            options = [f"--dependency=after:{learner}"] if job == "actors" else []
            self._submitted[job] = slurm.submit(str(script_path(self._run.folder, job)), options)

    def _first_moments(self) -> slurm.Job:
        """Return the learner's job once it waits or has run for a moment.

        Raises:
            CommandError: it has ended, or would wait for ever.
        """
        number, name = self._submitted["learner"], job_name(self._run.folder.name, "learner")
        deadline = time.monotonic() + FIRST_SECONDS
        while True:
            found = [job for job in slurm.jobs_named(name, ended=True) if job.number == number]
            job = found[0] if found else slurm.Job(number, "UNKNOWN", "", "")
            if found and (not job.alive or job.reason in NEVER):
                fate = " and would stay so" if job.alive else ""
                raise CommandError(f"{describe(job, self._run.folder)}{fate}; nothing is left in the queue")
            waits = job.state in slurm.WAITING and job.reason not in UNDECIDED
            if waits or time.monotonic() > deadline:
                return job
            time.sleep(POLL_SECONDS)

    def _take_back(self) -> None:
        with contextlib.suppress(CommandError):  # the first error is the one to be told
            slurm.cancel_jobs(list(self._submitted.values()))

    def _told(self, learner: slurm.Job) -> list[str]:
        folder, athrl = shlex.quote(str(self._run.folder)), program("athrl")
        others = ", ".join(f"{job} {self._submitted[job]}" for job in self._scripts if job != "learner")
        return [
            f"run {self._run.folder.name} in {folder}; {describe(learner, self._run.folder)}; {others}",
            f"to see it: {athrl} status --connect {folder}",
            f"to cancel it: {athrl} submit slurm --cancel {folder}",
        ]


def _remove(folders: list[Path]) -> None:
    """Remove a run's folder, and those above it, the nearest first, as long as nothing else is in them."""
    shutil.rmtree(folders[0], ignore_errors=True)
    with contextlib.suppress(OSError):
        for folder in folders[1:]:
            folder.rmdir()
