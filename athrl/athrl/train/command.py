"""`athrl train`: a whole run on this machine, from its start to its closing comparison."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from athrl import runs
from athrl.errors import say
from athrl.names import program
from athrl.options import CertificatesOption, RunFileOption, SetOption, overrides, use_certificates
from athrl.stopping import stop_on_signal
from athrl.train.closing import comparison_table, read_comparison
from athrl.train.display import Display
from athrl.train.plan import Plan, actors_that_fit, require_services, require_world
from athrl.train.session import TrainingSession
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
        int | None, typer.Option(min=1, help="Actors; by default as many as processors beside the learner's.")
    ] = None,
    resume: Annotated[
        str | None, typer.Option(metavar="RUN", help="Go on with an interrupted run, by its name or folder.")
    ] = None,
    viewer_port: Annotated[
        int,
        typer.Option(min=0, max=65535, metavar="PORT", help="Where rerun viewers connect; 0: no viewers."),
    ] = 9877,
    certificates: CertificatesOption = None,
) -> None:
    """Train on this machine: a learner, actors and an evaluator as processes of their own.

    The run ends by itself and prints the last policy's scores beside those of other drivers. Ctrl-C drains it
    and leaves a checkpoint; a second one stops at once.
    """
    require_services()
    plan = _plan(run_file, overrides(settings), name, resume)
    use_certificates(plan.settings.network.certificates)
    require_world(plan.settings.environment)
    began = time.time()
    with Display() as display:
        supervisor = Supervisor(display.say)
        with stop_on_signal(before_exit=supervisor.kill) as stop:
            session = TrainingSession(plan, supervisor, display, actors or actors_that_fit(), viewer_port)
            finished = session.run(stop)
    if not finished:
        say(f"stopped; to go on: {program('athrl')} train --resume {plan.folder}")
        raise typer.Exit(INTERRUPTED)
    Console().print(comparison_table(read_comparison(plan.folder, since=began)))
    print(f"policy: {plan.folder / 'policies' / 'latest.onnx'}")


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
            f"{runs.run_folder(settings)} holds a run already, --resume {settings.run.name} goes on with it; "
            f"this one is {free}"
        )
        given = [*given, f"run.name={free}"]
        settings = runs.new_settings(run_file, given)
    return Plan(settings, run_file=run_file, overrides=given, resume=False)
