"""`athrl learner`, `athrl actor`, `athrl evaluator`: one service of a run in this process."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from athrl import runs
from athrl.certificate_role import name_of_actor, require_role
from athrl.errors import needs, say
from athrl.options import (
    DEFAULTS,
    WHERE,
    CertificatesOption,
    FollowOption,
    MetricsListenOption,
    NameOption,
    RunFileOption,
    RunOption,
    SetOption,
    logged_refusals,
    overrides,
)
from athrl.rendezvous.following import follow
from athrl.rendezvous.listening import at_free_port
from athrl.rendezvous.run_folder import run_named
from athrl.service_names import own_name
from athrl.stopping import stop_on_signal

CHECKPOINT_SECONDS = 60.0
"""Limit for the learner to write its last checkpoint and to end."""

DRAIN_SECONDS = 30.0
"""Limit for an actor or the evaluator to send what it has and to end."""

COMPARISON_SECONDS = 1800.0
"""Limit for an evaluator's closing comparison, which outlasts the learner."""


def let_threads_sleep() -> None:
    """Let training threads sleep while they wait; their library reads this when torch is imported.

    Otherwise they spin on the cores of the actors: an update took more than four times as long.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def learner(
    run_file: RunFileOption = None,
    settings: SetOption = None,
    resume: Annotated[
        str | None, typer.Option(metavar="RUN", help="Name or folder of the run to resume.")
    ] = None,
    resume_if_present: Annotated[
        bool,
        typer.Option(
            "--resume-if-present", help="Resume the run if its folder holds one, otherwise start it."
        ),
    ] = False,
    reached_as: Annotated[
        str | None,
        typer.Option(
            metavar="HOST",
            help="Host name or address by which others reach this machine: keep the learner's address in the "
            "run's folder, for --connect FOLDER; if its port is in use, take the next free one.",
            rich_help_panel=WHERE,
        ),
    ] = None,
    check: Annotated[
        bool,
        typer.Option(
            "--check", help="Only check that the run can start or be resumed (exit code 0); start nothing."
        ),
    ] = False,
    certificates: CertificatesOption = None,
) -> None:
    """Receive experience, train, publish policies; owns the run, and ends with it."""
    let_threads_sleep()
    runs.declare_installed_planners()
    given = overrides(settings)
    if resume is None and resume_if_present:
        present = runs.folder_asked_for(run_file, given)
        resume = str(present) if runs.holds_run(present) else None
    folder: Path | None = None
    if resume is not None:
        run_settings, folder = runs.resumed_settings(resume, given, run_file)
    else:
        run_settings = runs.new_settings(run_file, given)
    # Signals are handled before the import, which takes seconds.
    secure = certificates is not None or bool(run_settings.network.certificates)
    with stop_on_signal(within=CHECKPOINT_SECONDS) as stop, logged_refusals(secure):
        with needs("learner"):
            from athrl_learner.run_settings import checked_settings
        checked_settings(run_settings, folder)  # wrong ones are refused before torch is imported
        other_towns = runs.told_other_towns(folder, run_settings) if folder is not None else ""
        if other_towns:
            say(other_towns)
        with needs("learner"):
            from athrl_learner import check_run, run_learner
        if check:
            print(check_run(run_settings, resume=folder))
            return
        if reached_as is not None:
            run_settings = at_free_port(run_settings, reached_as, secure=secure)
        if not stop.is_set():
            run_learner(run_settings, resume=folder, stop=stop, reached_as=reached_as)


def actor(
    connect: FollowOption = DEFAULTS.network.listen,
    run: RunOption = DEFAULTS.run.name,
    name: NameOption = None,
    certificates: CertificatesOption = None,
) -> None:
    """Drive environments with the newest policy and stream experience to the learner."""
    require_role(certificates, "actor")
    name = name_of_actor(certificates, name)
    with stop_on_signal(within=DRAIN_SECONDS) as stop:
        with needs("actor"):
            from athrl_actor import run_actor
        if not stop.is_set():
            wanted = run_named(connect, run)
            follow(
                connect,
                stop,
                lambda address, over: run_actor(
                    connect=address, run=wanted, name=name, stop=over, host=own_name()
                ),
            )


def evaluator(
    connect: FollowOption = DEFAULTS.network.listen,
    run: RunOption = DEFAULTS.run.name,
    name: NameOption = None,
    folder: Annotated[
        Path,
        typer.Option(envvar="ATHRL_FOLDER", help="Folder with the folders of runs, for results."),
    ] = Path(DEFAULTS.run.folder),
    certificates: CertificatesOption = None,
    metrics_listen: MetricsListenOption = "",
) -> None:
    """Score policies on fixed episodes, record them and stream them to viewers."""
    require_role(certificates, "evaluator")
    with stop_on_signal(within=DRAIN_SECONDS) as stop:
        with needs("evaluator"):
            from athrl_evaluator import run_evaluator
        if not stop.is_set():
            wanted, own = run_named(connect, run), name or "evaluator"
            follow(
                connect,
                stop,
                lambda address, over: run_evaluator(
                    connect=address,
                    run=wanted,
                    name=own,
                    folder=folder,
                    stop=over,
                    metrics_listen=metrics_listen,
                ),
                silent_seconds=COMPARISON_SECONDS,
            )
