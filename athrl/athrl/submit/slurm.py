"""Slurm's commands: submit, look and cancel; each answers in time, and an error is one line."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass

from athrl_spaces.wording import system_reason

from athrl.errors import CommandError

COMMANDS = ("sbatch", "squeue", "scancel", "scontrol")
ANSWER_SECONDS = 30.0
"""Limit for the answer of one command; a controller that is away lets a command try for a minute."""

WAITING = ("PENDING", "CONFIGURING")
ENDED = (
    "BOOT_FAIL",
    "CANCELLED",
    "COMPLETED",
    "DEADLINE",
    "FAILED",
    "NODE_FAIL",
    "OUT_OF_MEMORY",
    "PREEMPTED",
    "REVOKED",
    "TIMEOUT",
)
"""States of a job; in those that are in neither list it runs, or is about to end."""

_FIELDS = "%i|%T|%r|%N"


@dataclass(frozen=True)
class Job:
    """A job as `squeue` shows it.

    Attributes:
        number: such as 12, or 12_3 of a task of an array.
        state: such as PENDING.
        reason: why it waits or ended; `None` is Slurm's word for no reason.
        nodes: where it runs or ran, empty before.
    """

    number: str
    state: str
    reason: str
    nodes: str

    @property
    def alive(self) -> bool:
        """Whether it waits or runs."""
        return self.state not in ENDED

    def __str__(self) -> str:
        at = f" on {self.nodes}" if self.nodes else ""
        told = self.reason not in ("", "None") and self.state not in ("CANCELLED", "COMPLETED")
        reason = f" ({self.reason})" if told else ""
        return f"{self.number} is {self.state}{at}{reason}"


def is_here() -> bool:
    """Return whether Slurm's commands are on this machine."""
    return all(shutil.which(command) for command in COMMANDS)


def require_slurm() -> None:
    """Raise CommandError on a machine without Slurm's commands."""
    missing = [command for command in COMMANDS if shutil.which(command) is None]
    if missing:
        raise CommandError(
            f"there is no Slurm on this machine, {missing[0]} is not on the PATH: run this on a login node"
        )


def check(script: str, options: Sequence[str] = ()) -> None:
    """Ask Slurm whether it would ever start a script; nothing is submitted.

    Raises:
        CommandError: it would not; in Slurm's words.
    """
    _call(["sbatch", "--test-only", *options], given=script)


def submit(path: str, options: Sequence[str] = ()) -> str:
    """Submit the script at `path`; return the job's number.

    Raises:
        CommandError: Slurm takes no such job; in its words.
    """
    return _call(["sbatch", "--parsable", *options, path]).strip().partition(";")[0]


def jobs_named(*names: str, ended: bool = False) -> list[Job]:
    """Return this user's jobs of these names, the newest first; with `ended` also those Slurm still knows."""
    states = ["--states=all"] if ended else []
    words = ["squeue", "--noheader", f"--user={os.getuid()}", f"--name={','.join(names)}"]
    lines = _call([*words, "--array", "--sort=-i", f"--format={_FIELDS}", *states]).splitlines()
    return [Job(*(part.strip() for part in line.split("|"))) for line in lines if line.count("|") == 3]


def cancel(*names: str) -> None:
    """Cancel this user's jobs of these names; there may be none."""
    for name in names:
        _call(["scancel", f"--user={os.getuid()}", f"--name={name}"])


def cancel_jobs(numbers: Sequence[str]) -> None:
    """Cancel jobs by their numbers."""
    if numbers:
        _call(["scancel", *numbers])


def _call(words: list[str], given: str | None = None) -> str:
    try:
        done = subprocess.run(
            words,
            input=given,
            stdin=subprocess.DEVNULL if given is None else None,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=ANSWER_SECONDS,
        )
    except subprocess.TimeoutExpired:
        raise CommandError(
            f"Slurm: {words[0]} did not answer within {ANSWER_SECONDS:g} s: is its controller up? "
            "see scontrol ping"
        ) from None
    except OSError as error:
        raise CommandError(f"Slurm: cannot run {words[0]}: {system_reason(error)}") from None
    if done.returncode:
        raise CommandError(f"Slurm: {_complaint(words[0], done.stderr) or f'{words[0]} failed'}")
    return done.stdout


def _complaint(command: str, said: str) -> str:
    """Return what a command said, each thing once, in one line."""
    lines = (line.removeprefix(f"{command}: ").removeprefix("error: ").strip() for line in said.splitlines())
    told = dict.fromkeys(line for line in lines if line)
    final = [line.removeprefix("fatal: ") for line in told if line.startswith("fatal: ")]
    return "; ".join(final or told)
