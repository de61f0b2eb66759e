"""`athrl learner`, `athrl actor`, `athrl evaluator`: one service of a run in this process."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from athrl import runs
from athrl.errors import needs
from athrl.names import own_name
from athrl.options import (
    DEFAULTS,
    CertificatesOption,
    ConnectOption,
    NameOption,
    RunFileOption,
    RunOption,
    SetOption,
    overrides,
    refusals_told,
)
from athrl.single_role import require_role
from athrl.stopping import stop_on_signal

CHECKPOINT_SECONDS = 60.0
"""How long the learner may take to write its last checkpoint and to leave."""

DRAIN_SECONDS = 30.0
"""How long an actor or the evaluator may take to hand over what it has and to leave."""


def let_threads_sleep() -> None:
    """Have training's threads wait for each other asleep; read by their library when torch is imported.

    They would spin otherwise, on the cores on which actors drive: an update took four times as long and more.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def learner(
    run_file: RunFileOption = None,
    settings: SetOption = None,
    resume: Annotated[
        str | None, typer.Option(metavar="RUN", help="Continue the run of this name or folder.")
    ] = None,
    resume_if_present: Annotated[
        bool,
        typer.Option(
            "--resume-if-present", help="Continue the run when its folder holds one, else start it."
        ),
    ] = False,
    certificates: CertificatesOption = None,
) -> None:
    """Take experience in, train, publish policies; owns the run, and ends with it."""
    let_threads_sleep()
    runs.know_planners()
    given = overrides(settings)
    folder: Path | None
    if resume is not None:
        run_settings, folder = runs.resumed_settings(resume, given)
    else:
        run_settings = runs.new_settings(run_file, given)
        folder = runs.run_folder(run_settings)
        if not (resume_if_present and runs.holds_run(folder)):
            folder = None
    # The signals are caught before the import, which takes seconds.
    secure = certificates is not None or bool(run_settings.network.certificates)
    with stop_on_signal(within=CHECKPOINT_SECONDS) as stop, refusals_told(secure):
        with needs("learner"):
            from athrl_learner import run_learner
        if not stop.is_set():
            run_learner(run_settings, resume=folder, stop=stop)


def actor(
    connect: ConnectOption = DEFAULTS.network.listen,
    run: RunOption = DEFAULTS.run.name,
    name: NameOption = None,
    certificates: CertificatesOption = None,
) -> None:
    """Drive environments with the newest policy and stream what happens to the learner."""
    require_role(certificates, "actor")
    with stop_on_signal(within=DRAIN_SECONDS) as stop:
        with needs("actor"):
            from athrl_actor import run_actor
        if not stop.is_set():
            run_actor(connect=connect, run=run, name=name or own_name(), stop=stop)


def evaluator(
    connect: ConnectOption = DEFAULTS.network.listen,
    run: RunOption = DEFAULTS.run.name,
    name: NameOption = None,
    folder: Annotated[
        Path,
        typer.Option(
            envvar="ATHRL_FOLDER", help="Folder that holds the runs' folders; results are written there."
        ),
    ] = Path(DEFAULTS.run.folder),
    certificates: CertificatesOption = None,
) -> None:
    """Score policies on fixed episodes, record them and let them be watched."""
    require_role(certificates, "evaluator")
    with stop_on_signal(within=DRAIN_SECONDS) as stop:
        with needs("evaluator"):
            from athrl_evaluator import run_evaluator
        if not stop.is_set():
            run_evaluator(connect=connect, run=run, name=name or "evaluator", folder=folder, stop=stop)
