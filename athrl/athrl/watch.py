"""`athrl watch`: see an episode in rerun, live or recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from athrl.errors import CommandError, needs
from athrl.options import DEFAULTS, CertificatesOption, ConnectOption, LiveRunOption
from athrl.stopping import stop_on_signal


def watch(
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="[ACTOR|FILE.mcap]",
            help="An actor's name, or a recorded episode; without it the evaluator is watched.",
        ),
    ] = None,
    connect: ConnectOption = DEFAULTS.network.listen,
    run: LiveRunOption = None,
    serve: Annotated[
        int | None,
        typer.Option(min=1, max=65535, metavar="PORT", help="Serve viewers at this port and open no window."),
    ] = None,
    bind: Annotated[
        str, typer.Option(help="Address of this machine at which --serve listens.")
    ] = "127.0.0.1",
    certificates: CertificatesOption = None,
) -> None:
    """Draw an episode in rerun: the evaluator's or an actor's while it is driven, or a recorded one."""
    _require_actor_or_recording(what)
    role, name = ("actor", what) if what is not None else ("evaluator", "evaluator")
    with stop_on_signal() as stop:
        with needs("evaluator"):
            from athrl_evaluator.watch import watch as draw_frames
            from athrl_evaluator.watch import watch_recording
        if what is not None and what.endswith(".mcap"):
            watch_recording(Path(what), serve=serve, bind=bind, stop=stop)
            return
        draw_frames(connect=connect, run=run, role=role, name=name, serve=serve, bind=bind, stop=stop)


def _require_actor_or_recording(what: str | None) -> None:
    """Raise CommandError for a path that can be no actor's name and is no recording."""
    if what is None or what.endswith(".mcap"):
        return
    if "/" in what or Path(what).exists():
        raise CommandError(f"{what} is no recorded episode (FILE.mcap) and no actor's name")
