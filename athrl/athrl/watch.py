"""`athrl watch`: see an episode live in rerun."""

from __future__ import annotations

from typing import Annotated

import typer

from athrl.errors import needs
from athrl.options import DEFAULTS, ConnectOption, RunOption
from athrl.stopping import stop_on_signal


def watch(
    actor: Annotated[
        str | None, typer.Argument(help="Name of the actor to watch; without it the evaluator is watched.")
    ] = None,
    connect: ConnectOption = DEFAULTS.network.listen,
    run: RunOption = DEFAULTS.run.name,
    serve: Annotated[
        int | None,
        typer.Option(min=1, max=65535, metavar="PORT", help="Serve viewers at this port and open no window."),
    ] = None,
    bind: Annotated[
        str, typer.Option(help="Address of this machine at which --serve listens.")
    ] = "127.0.0.1",
) -> None:
    """Draw the live frames of the evaluator's or of an actor's episode in rerun."""
    role, name = ("actor", actor) if actor is not None else ("evaluator", "evaluator")
    with stop_on_signal() as stop:
        with needs("evaluator"):
            from athrl_evaluator.watch import watch as draw_frames
        draw_frames(connect=connect, run=run, role=role, name=name, serve=serve, bind=bind, stop=stop)
