"""`athrl train`: a whole run on this machine, from its start to its closing comparison."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from athrl_protocol.certificates import VARIABLE
from athrl_protocol.run_file import read_run_file
from rich.console import Console

from athrl import runs
from athrl.errors import CommandError, say
from athrl.names import program
from athrl.options import CertificatesOption, RunFileOption, SetOption, overrides, use_certificates
from athrl.services import CHECKPOINT_SECONDS
from athrl.single_role import require_all_roles
from athrl.stopping import stop_on_signal
from athrl.train.closing import compared_decisions, comparison_tables, read_comparison
from athrl.train.display import Display
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

INTERRUPTED = 130
"""Exit code of a run that was stopped before its end, as a shell gives to what Ctrl-C ended."""


def train(
    run_file: RunFileOption = None,
    settings: SetOption = None,
    name: Annotated[
        str | None, typer.Option(metavar="RUN", help="The run's name; another name, another folder.")
    ] = None,
    actors: Annotated[
        int | None, typer.Option(min=1, help="Actors; by default as many as the learner needs.")
    ] = None,
    resume: Annotated[
        str | None, typer.Option(metavar="RUN", help="Continue an interrupted run, by its name or folder.")
    ] = None,
    viewer_port: Annotated[
        int,
        typer.Option(min=0, max=65535, metavar="PORT", help="Where rerun viewers connect; 0: no viewers."),
    ] = 9877,
    serial: Annotated[
        bool,
        typer.Option(
            "--serial", help="Drive and train in turns in one process; the run repeats itself bit for bit."
        ),
    ] = False,
    stop_at: Annotated[
        int | None,
        typer.Option(min=1, metavar="STEPS", help="Stop a serial run when it has so many decisions in all."),
    ] = None,
    certificates: CertificatesOption = None,
) -> None:
    """Train on this machine: a learner, actors and an evaluator as processes of their own.

    The run ends by itself and prints the last policy's scores beside those of other drivers. Ctrl-C drains it
    and leaves a checkpoint; a second one stops at once.
    """
    require_services()
    runs.know_planners()
    given = [*overrides(settings), *(["serial.enabled=true"] if serial else [])]
    plan = _plan(run_file, given, name, resume)
    _require_fitting(plan, actors, stop_at)
    require_world(plan.settings.environment)
    began = time.time()
    if plan.settings.serial.enabled:
        finished = _run_serially(plan, stop_at)
    else:
        division = divide_cores(usable_cores(), threads=plan.settings.learner.threads, actors=actors)
        finished = _run_distributed(plan, division, viewer_port, certificates)
    if not finished:
        say(f"stopped; to continue: {_to_continue(plan)}")
        raise typer.Exit(INTERRUPTED)
    for table in comparison_tables(read_comparison(plan.folder, since=began)):
        Console().print(table)
    print(f"policy: {plan.folder / 'policies' / 'latest.onnx'}")


def _run_distributed(plan: Plan, division: CoreDivision, viewer_port: int, certificates: Path | None) -> bool:
    """Run learner, actors and evaluator as processes; whether the run is finished."""
    require_all_roles(use_certificates(plan.settings.network.certificates) or certificates)
    with Display() as display:
        supervisor = Supervisor(display.say)
        with stop_on_signal(before_exit=supervisor.kill, within=STOP_SECONDS) as stop:
            return TrainingSession(plan, supervisor, display, division, viewer_port).run(stop)


def _run_serially(plan: Plan, stop_at: int | None) -> bool:
    """Drive and train in turns in this process; whether the run is finished."""
    with ExitStack() as stack:
        display = stack.enter_context(Display())
        stopping = partial(display.say, "stopping after this round; once more stops at once")
        stop = stack.enter_context(stop_on_signal(on_stop=stopping, within=CHECKPOINT_SECONDS))
        display.say(f"run {plan.settings.run.name} in {plan.folder}: serial, fingerprints in trace.txt")
        from athrl.serial.session import run_serial

        finished = run_serial(plan.settings, resume=plan.resume, stop=stop, stop_at=stop_at, display=display)
        asked = not stop.is_set()
    if not finished and asked:
        say(f"stopped where --stop-at wanted it; to continue: {_to_continue(plan)}")
        raise typer.Exit
    return finished


def _to_continue(plan: Plan) -> str:
    command = f"{program('athrl')} train --resume {plan.folder}"
    folder = os.environ.get(VARIABLE)
    kept = plan.settings.network.certificates or plan.settings.serial.enabled
    return command if kept or not folder else f"{command} --certificates {folder}"


def _require_fitting(plan: Plan, actors: int | None, stop_at: int | None) -> None:
    """Refuse options that the kind of run has no use for, and to continue a run as one of another kind."""
    serial = plan.settings.serial.enabled
    if serial and actors is not None:
        raise CommandError("a serial run has one actor, in its own process: leave --actors out")
    if not serial and stop_at is not None:
        raise CommandError("--stop-at is for serial runs: give --serial, too, or stop the run with Ctrl-C")
    if not plan.resume:
        return
    began_serial = read_run_file(plan.folder / "run.toml", complete=True).serial.enabled
    if began_serial != serial:
        raise CommandError(
            f"{plan.folder} is a serial run and goes on as one only: leave serial.enabled out"
            if began_serial
            else f"{plan.folder} is a distributed run, whose checkpoints hold no environments: "
            "continue without --serial"
        )
    decisions, wanted = compared_decisions(plan.folder), plan.settings.run.environment_steps
    if not serial and decisions >= wanted:
        raise CommandError(
            f"{plan.folder} is finished, with {decisions} of {wanted} decisions and its comparison in "
            f"evaluation.json: to make it longer add --set run.environment_steps={2 * wanted}"
        )


def _plan(run_file: Path | None, given: list[str], name: str | None, resume: str | None) -> Plan:
    """Find out which run it is; a name that is taken and was not asked for gets a number."""
    if resume is not None:
        settings, _ = runs.resumed_settings(resume, given)
        return Plan(settings, run_file=None, overrides=given, resume=True)
    if name is not None:
        given = [*given, f"run.name={name}"]
    settings = runs.new_settings(run_file, given)
    free = runs.unused_name(settings)
    if free != settings.run.name:
        say(
            f"{runs.run_folder(settings)} holds a run already, --resume {settings.run.name} continues it; "
            f"this one is {free}"
        )
        given = [*given, f"run.name={free}"]
        settings = runs.new_settings(run_file, given)
    return Plan(settings, run_file=run_file, overrides=given, resume=False)
