"""`athrl submit slurm`: a run as jobs of Slurm: a learner, an evaluator, and an array of actors."""

from __future__ import annotations

import contextlib
import os
import shlex
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from athrl_protocol.run_file import RunFile
from athrl_protocol.run_file.toml_values import to_toml_value
from athrl_protocol.transport.address import is_loopback, split_address

from athrl import runs
from athrl.errors import CommandError, say
from athrl.options import SetOption, overrides
from athrl.submit.cancelling import cancel_run
from athrl.submit.learner_job import SCRIPTS
from athrl.submit.scripts import Request, Run, make_scripts, script_path
from athrl.submit.submission import Submission
from athrl.train.plan import require_world

_JOBS, _OTHERWISE = "What the jobs ask for", "Instead of submitting"


class Scheduler(StrEnum):
    """Schedulers to which runs can be submitted."""

    SLURM = "slurm"


def submit(
    scheduler: Annotated[Scheduler, typer.Argument(metavar="slurm", help="The scheduler.")],
    run_file: Annotated[
        Path | None, typer.Argument(metavar="[RUN.toml]", help="Run file; by default the default settings.")
    ] = None,
    settings: SetOption = None,
    name: Annotated[
        str | None, typer.Option(metavar="RUN", help="Name of the run and of its folder: a-z, 0-9, _, -.")
    ] = None,
    actors: Annotated[
        int, typer.Option(min=1, help="Actors: an array of jobs of one core each.", rich_help_panel=_JOBS)
    ] = 8,
    cpus: Annotated[int, typer.Option(min=1, help="Cores of the learner.", rich_help_panel=_JOBS)] = 4,
    gpus: Annotated[
        str,
        typer.Option(
            metavar="[TYPE:]N",
            help="GPUs of the learner, such as a100:1; also set learner.device=cuda.",
            rich_help_panel=_JOBS,
        ),
    ] = "",
    partition: Annotated[
        str | None, typer.Option(help="Partition of all jobs.", rich_help_panel=_JOBS)
    ] = None,
    account: Annotated[str | None, typer.Option(help="Account of all jobs.", rich_help_panel=_JOBS)] = None,
    time: Annotated[
        str | None,
        typer.Option(
            help="Time limit of each job, such as 12:00:00; then it requeues itself.", rich_help_panel=_JOBS
        ),
    ] = None,
    sbatch: Annotated[
        list[str] | None,
        typer.Option(metavar="OPTIONS", help="More options of sbatch, for all jobs.", rich_help_panel=_JOBS),
    ] = None,
    learner_sbatch: Annotated[
        list[str] | None,
        typer.Option(metavar="OPTIONS", help="The same for the learner alone.", rich_help_panel=_JOBS),
    ] = None,
    actor_sbatch: Annotated[
        list[str] | None,
        typer.Option(
            metavar="OPTIONS",
            help="The same for the actors alone, such as --partition=preemptible.",
            rich_help_panel=_JOBS,
        ),
    ] = None,
    program: Annotated[
        str | None,
        typer.Option(
            metavar="COMMAND",
            help="Command that runs athrl on the nodes, such as 'apptainer exec --nv athrl.sif athrl'; "
            "by default this Python.",
            rich_help_panel=_JOBS,
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the scripts.", rich_help_panel=_OTHERWISE)
    ] = False,
    cancel: Annotated[
        str | None,
        typer.Option(
            metavar="RUN",
            help="Drain the jobs of this run, a name or a folder.",
            rich_help_panel=_OTHERWISE,
        ),
    ] = None,
) -> None:
    """Submit a run to Slurm; a run whose folder is there already is resumed.

    Preempted, requeued or at their time limit, jobs drain and continue by themselves.
    """
    if cancel is not None:
        cancel_run(Path(cancel).resolve().name)
        return
    given = overrides(settings)
    if name is not None:
        runs.require_name(name, f"--name {name}")
        given = [*given, f"run.name={to_toml_value(name)}"]
    wanted = _settings(run_file, given)
    here = _working_folder()
    folder = Path(os.path.normpath(here / runs.run_folder(wanted)))
    lines = [_line(option, value) for option, value in (
        ("partition", partition), ("account", account), ("time", time)) if value is not None]  # fmt: skip
    request = Request(
        actors=actors,
        cpus=cpus,
        gpus=_without_spaces("gpus", gpus),
        every=[*lines, *_lines("sbatch", sbatch)],
        learner=_lines("learner-sbatch", learner_sbatch),
        actor=_lines("actor-sbatch", actor_sbatch),
    )
    for path in (folder, here):
        _require_plain(path)
    run = Run(folder, _program(program), _learner_words(run_file, given, wanted, folder), here)
    scripts = make_scripts(run, request)
    if dry_run:
        for job, script in scripts.items():
            print(f"# ==> {script_path(folder, job)}\n{script}")
        return
    for line in Submission(run, scripts, run_file).submit():
        say(line)


def _settings(run_file: Path | None, given: list[str]) -> RunFile:
    """Return the run's settings, checked as the learner and the actors will."""
    runs.declare_installed_planners()
    folder = runs.folder_asked_for(run_file, given)
    if runs.holds_run(folder):
        wanted, _ = runs.resumed_settings(str(folder), given, run_file)
        other_towns = runs.told_other_towns(folder, wanted)
    else:
        wanted, other_towns = runs.new_settings(run_file, given), ""
    if wanted.serial.enabled:
        raise CommandError("a serial run is one process: submit `athrl train --serial` as a job of your own")
    if wanted.network.certificates:
        raise CommandError(
            f"network.certificates is {wanted.network.certificates}: a submitted run has its own, in "
            "its folder: leave it out"
        )
    require_world(wanted.environment)
    if other_towns:
        say(other_towns)
    return wanted


def _learner_words(run_file: Path | None, given: list[str], wanted: RunFile, folder: Path) -> list[str]:
    """Return the words by which a job's learner has the same settings as were checked here."""
    host, port = split_address(wanted.network.listen)
    at = f"tls/0.0.0.0:{port}" if is_loopback(host) else wanted.network.listen
    settings = [
        *given,
        f"run.name={to_toml_value(folder.name)}",
        f"run.folder={to_toml_value(str(folder.parent))}",
        f"network.listen={to_toml_value(at)}",
    ]
    file = [] if run_file is None else ["--run-file", str(folder / SCRIPTS / "run.toml")]
    return [*file, *(word for setting in settings for word in ("--set", setting))]


def _working_folder() -> Path:
    """Return the working folder by the name that the shell has for it.

    What it is a link to may have another name on the nodes, such as where home folders are mounted on demand.
    """
    named = os.environ.get("PWD", "")
    with contextlib.suppress(OSError):
        if os.path.isabs(named) and os.path.samefile(named, os.curdir):
            return Path(named)
    return Path.cwd()


def _require_plain(path: Path) -> None:
    """Refuse a path that cannot stand in a script's `#SBATCH` line."""
    if '"' in str(path) or not str(path).isprintable():
        raise CommandError(f"{str(path)!r}: sbatch takes no path with a quotation mark or a line break")


def _program(given: str | None) -> list[str]:
    """Return the words of the command that runs athrl: that which was given, or this Python."""
    if given is None:
        return [sys.executable, "-m", "athrl"]
    try:
        words = shlex.split(given)
    except ValueError as error:
        raise CommandError(f"--program {given!r}: {str(error).lower()}") from None
    if not words or "\n" in given:
        raise CommandError(f"--program {given!r}: should be a command, such as /opt/athrl/bin/athrl")
    return [os.path.abspath(words[0]) if os.path.isfile(words[0]) else words[0], *words[1:]]


def _line(option: str, value: str) -> str:
    return f"--{option}={_without_spaces(option, value)}"


def _without_spaces(option: str, value: str) -> str:
    if any(sign.isspace() or not sign.isprintable() for sign in value):
        raise CommandError(f"--{option} {value!r}: should be one word")
    return value


def _lines(option: str, given: list[str] | None) -> list[str]:
    """Return options of sbatch, each of which is a line of a script."""
    for words in given or []:
        if not words.startswith("-") or not words.isprintable():
            raise CommandError(f"--{option} {words!r}: should be sbatch's options, such as --mem=8G")
    return list(given or [])
