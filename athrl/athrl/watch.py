"""`athrl watch`: see an episode in rerun: of a run or of a policy while it is driven, or recorded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from athrl_protocol.run_file import EnvironmentSection

from athrl.errors import CommandError, needs
from athrl.evaluate import check_town, find_driver
from athrl.options import DEFAULTS, CertificatesOption, ConnectOption, ForceOption, LiveRunOption
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
    policy: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE|random|blind|rule-based",
            help="Watch this driver, without any run; `athrl policies` lists the names.",
        ),
    ] = None,
    town: Annotated[
        str | None, typer.Option(help="With --policy: the town to drive in, or a map; by default town03.")
    ] = None,
    force: ForceOption = None,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="With --policy: end after so many episodes.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="With --policy: the first episode's seed, by default 0.")
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.rrd",
            help="With --policy: write the episodes, by default one, into a rerun file and open no window.",
        ),
    ] = None,
) -> None:
    """Draw an episode in rerun: the evaluator's or an actor's while it is driven, or a recorded one.

    With --policy nothing needs to be running: that policy drives one episode after the other.
    """
    if policy is not None:
        _require_alone(what, serve, save)
        _watch_policy(policy, town, force or [], episodes, seed or 0, serve, bind, save)
        return
    of_policy = {"town": town, "force": force or None, "episodes": episodes, "seed": seed, "save": save}
    for option in (option for option, value in of_policy.items() if value is not None):
        raise CommandError(f"--{option} is for watching a policy without a run: give --policy, too")
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


def _require_alone(what: str | None, serve: int | None, save: Path | None) -> None:
    """Refuse what has no place beside --policy."""
    if what is not None:
        raise CommandError(f"{what} has no place beside --policy, which needs no run: leave one out")
    if serve is not None and save is not None:
        raise CommandError("--serve has no place beside --save, which opens no viewer: leave one out")


def _watch_policy(
    policy: str,
    town: str | None,
    force: Sequence[str],
    episodes: int | None,
    seed: int,
    serve: int | None,
    bind: str,
    save: Path | None,
) -> None:
    """Have a driver drive and show it; a file gets one episode unless more are wanted."""
    if town is not None:
        check_town(town)
    driver = find_driver(policy)
    section = EnvironmentSection() if town is None else EnvironmentSection.model_validate({"towns": town})
    with stop_on_signal() as stop:
        with needs("evaluator"):
            from athrl_evaluator.watch_policy import watch_policy
        watch_policy(
            driver,
            environment=section,
            forced=force,
            episodes=1 if episodes is None and save is not None else episodes,
            seed=seed,
            serve=serve,
            bind=bind,
            save=save,
            stop=stop,
        )
