"""`athrl train`: a complete run on this machine, from start to closing comparison."""

from __future__ import annotations

import os
import shlex
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from athrl_protocol.announcements.comparison import COMPARISON_FILE, compared_decisions
from athrl_protocol.run_file import read_run_file, with_whole_maps
from athrl_protocol.run_file.toml_values import to_toml_value
from athrl_protocol.security.certificates import VARIABLE
from rich.console import Console

from athrl import runs
from athrl.certificate_role import require_all_roles
from athrl.display import Display
from athrl.errors import CommandError, say
from athrl.options import (
    WHAT,
    WHERE,
    CertificatesOption,
    RunFileOption,
    SetOption,
    overrides,
    use_certificates,
)
from athrl.service_names import program
from athrl.services import CHECKPOINT_SECONDS
from athrl.stopping import stop_on_signal
from athrl.train.comparison import comparison_tables, read_comparison
from athrl.train.plan import (
    CoreDivision,
    Plan,
    divide_cores,
    require_services,
    require_world,
    usable_cores,
)
from athrl.train.session import STOP_SECONDS, TrainingSession
from athrl.train.supervisor import Supervisor

_SERIAL = "Serial runs"

VIEWER_PORT = 9877

INTERRUPTED = 130
"""Exit code of a run that was stopped before its end, as of a shell after Ctrl-C."""


def train(
    run_file: RunFileOption = None,
    settings: SetOption = None,
    name: Annotated[
        str | None,
        typer.Option(
            metavar="RUN", help="Name of the run and of its folder: a-z, 0-9, _, -.", rich_help_panel=WHAT
        ),
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(metavar="RUN", help="Name or folder of the run to resume.", rich_help_panel=WHAT),
    ] = None,
    actors: Annotated[
        int | None,
        typer.Option(
            min=1, help="Number of actors; by default as many as the learner needs.", rich_help_panel=WHERE
        ),
    ] = None,
    viewer_port: Annotated[
        int,
        typer.Option(
            min=0,
            max=65535,
            metavar="PORT",
            help="Port for rerun viewers; 0: no viewers.",
            rich_help_panel=WHERE,
        ),
    ] = VIEWER_PORT,
    serial: Annotated[
        bool,
        typer.Option(
            "--serial",
            help="Drive and train alternately in one process, repeatable bit for bit.",
            rich_help_panel=_SERIAL,
        ),
    ] = False,
    stop_at: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="STEPS",
            help="Stop after this total number of decisions.",
            rich_help_panel=_SERIAL,
        ),
    ] = None,
    certificates: CertificatesOption = None,
) -> None:
    """Train on this machine: a learner, actors and an evaluator as separate processes.

    At its end the run prints the scores of the last policy and of the reference drivers. Ctrl-C drains the
    run and writes a checkpoint; a second Ctrl-C stops it at once.
    """
    require_services()
    runs.declare_installed_planners()
    given = [*overrides(settings), *(["serial.enabled=true"] if serial else [])]
    plan = _plan(run_file, given, name, resume)
    other_towns = runs.told_other_towns(plan.folder, plan.settings) if plan.resume else ""
    _require_fitting(plan, actors, viewer_port, stop_at)
    if plan.resume:
        runs.require_same_environments(plan.folder, plan.settings)
    if _said_finished(plan):
        return
    require_world(plan.settings.environment)
    if other_towns:
        say(other_towns)
    began = time.time()
    if plan.settings.serial.enabled:
        finished = _run_serially(plan, stop_at)
    else:
        division = divide_cores(usable_cores(), threads=plan.settings.learner.threads, actors=actors)
        finished = _run_distributed(plan, division, viewer_port, certificates)
    if not finished:
        say(f"stopped; to continue: {_to_continue(plan, actors, viewer_port)}")
        raise typer.Exit(INTERRUPTED)
    for table in comparison_tables(read_comparison(plan.folder, since=began)):
        Console(emoji=False).print(table)
    print(f"policy: {plan.folder / 'policies' / 'latest.onnx'}")


def _run_distributed(plan: Plan, division: CoreDivision, viewer_port: int, certificates: Path | None) -> bool:
    """Run learner, actors and evaluator as processes; return whether the run is finished."""
    require_all_roles(use_certificates(plan.settings.network.certificates) or certificates)
    with Display() as display:
        supervisor = Supervisor(display.say)
        with stop_on_signal(before_exit=supervisor.kill, within=STOP_SECONDS) as stop:
            return TrainingSession(plan, supervisor, display, division, viewer_port).run(stop)


def _run_serially(plan: Plan, stop_at: int | None) -> bool:
    """Drive and train alternately in this process; return whether the run is finished."""
    with ExitStack() as stack:
        display = stack.enter_context(Display())
        stopping = partial(display.say, "stopping after this round; a second signal stops at once")
        stop = stack.enter_context(stop_on_signal(on_stop=stopping, within=CHECKPOINT_SECONDS))
        display.say(f"run {plan.settings.run.name} in {plan.folder}: serial, fingerprints in trace.txt")
        from athrl.serial.session import run_serial

        finished = run_serial(plan.settings, resume=plan.resume, stop=stop, stop_at=stop_at, display=display)
        asked = not stop.is_set()
    if not finished and asked:
        say(f"stopped at --stop-at; to continue: {_to_continue(plan)}")
        raise typer.Exit
    return finished


def _to_continue(plan: Plan, actors: int | None = None, viewer_port: int = VIEWER_PORT) -> str:
    """Return the command, with the options that belong to this machine and not to the run."""
    words = [program("athrl"), "train", "--resume", str(plan.folder)]
    if actors is not None:
        words += ["--actors", str(actors)]
    if viewer_port != VIEWER_PORT and not plan.settings.serial.enabled:
        words += ["--viewer-port", str(viewer_port)]
    folder = os.environ.get(VARIABLE)
    kept = plan.settings.network.certificates or plan.settings.serial.enabled
    return shlex.join(words if kept or not folder else [*words, "--certificates", folder])


def _require_fitting(plan: Plan, actors: int | None, viewer_port: int, stop_at: int | None) -> None:
    """Refuse options that do not fit the kind of run, and resuming a run as another kind."""
    serial = plan.settings.serial.enabled
    if serial and actors is not None:
        raise CommandError("a serial run has one actor, in its own process: leave --actors out")
    if serial and viewer_port not in (0, VIEWER_PORT):
        raise CommandError("a serial run streams nothing to viewers: leave --viewer-port out")
    if not serial and stop_at is not None:
        raise CommandError("--stop-at is for serial runs: add --serial, or stop the run with Ctrl-C")
    if not plan.resume:
        return
    began_serial = read_run_file(plan.folder / "run.toml", complete=True).serial.enabled
    if began_serial != serial:
        raise CommandError(
            f"{plan.folder} is a serial run and can only be resumed as one: leave serial.enabled out"
            if began_serial
            else f"{plan.folder} is a distributed run, whose checkpoints hold no environments: "
            "continue without --serial"
        )


def _said_finished(plan: Plan) -> bool:
    """Say that a run which is resumed is finished and compared already; return whether it is."""
    decisions, wanted = compared_decisions(plan.folder), plan.settings.run.environment_steps
    if not plan.resume or decisions < wanted:
        return False
    say(
        f"{plan.folder} is finished, with {decisions} of {wanted} decisions and its comparison in "
        f"{COMPARISON_FILE}: to make it longer add --set run.environment_steps={2 * wanted}"
    )
    return True


def _plan(run_file: Path | None, given: list[str], name: str | None, resume: str | None) -> Plan:
    """Return the plan of the run; a default name that is taken gets a number."""
    if resume is not None:
        if name is not None:
            raise CommandError(f"--name {name}: a run that is resumed keeps its name: leave --name out")
        settings, _ = runs.resumed_settings(resume, given, run_file)
        return Plan(with_whole_maps(settings), run_file=run_file, overrides=given, resume=True)
    if name is not None:
        runs.require_name(name, f"--name {name}")
        given = [*given, f"run.name={to_toml_value(name)}"]
    settings = runs.new_settings(run_file, given)
    free = runs.unused_name(settings)
    if free != settings.run.name:
        say(
            f"{runs.run_folder(settings)} already holds a run, --resume {settings.run.name} resumes it; "
            f"this one is {free}"
        )
        given = [*given, f"run.name={to_toml_value(free)}"]
        settings = runs.new_settings(run_file, given)
    return Plan(with_whole_maps(settings), run_file=run_file, overrides=given, resume=False)
