"""`athrl watch`: show an episode in rerun: live, of a run or a policy, or recorded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from athrl_protocol.run_file import EnvironmentSection
from athrl_spaces.wording import counted

from athrl.errors import CommandError, needs
from athrl.evaluate.drivers import find_driver
from athrl.evaluate.places import check_town
from athrl.options import (
    DEFAULTS,
    CertificatesOption,
    ConnectOption,
    ForceOption,
    LiveRunOption,
    OverwriteOption,
)
from athrl.stopping import stop_on_signal

if TYPE_CHECKING:
    from athrl_evaluator.watching.viewer import Server


LOOPBACK = "127.0.0.1"


def watch(
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="[ACTOR|FILE.mcap]",
            help="Name of an actor, or a recorded episode; by default the evaluator.",
        ),
    ] = None,
    connect: ConnectOption = DEFAULTS.network.listen,
    run: LiveRunOption = None,
    serve: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=65535,
            metavar="PORT",
            help="Port for viewers, instead of a window; with --browser by default the one after the page's.",
        ),
    ] = None,
    browser: Annotated[
        bool,
        typer.Option(
            "--browser",
            help="Serve the viewer as a page, instead of a window; to open it on another machine: "
            "ssh -L 9890:localhost:9890 -L 9891:localhost:9891 HERE.",
        ),
    ] = False,
    page: Annotated[
        int | None,
        typer.Option(min=1, max=65534, metavar="PORT", help="Port of --browser's page; by default 9890."),
    ] = None,
    bind: Annotated[str, typer.Option(help="Address at which --serve and --browser listen.")] = LOOPBACK,
    certificates: CertificatesOption = None,
    policy: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE|random|blind|rule-based",
            help="Watch this driver, without a run; `athrl policies` lists the names.",
        ),
    ] = None,
    town: Annotated[
        str | None, typer.Option(help="With --policy: town or map to drive in; by default town03.")
    ] = None,
    vehicles: Annotated[
        int | None, typer.Option(min=0, help="With --policy: background vehicles; by default 100.")
    ] = None,
    force: ForceOption = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="With --policy: number of episodes.")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="With --policy: seed of the first episode; by default 0.")
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.rrd",
            help="With --policy: write the episodes, by default one, to a rerun file, instead of a window.",
        ),
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Show an episode in rerun: live from the evaluator or an actor, or recorded.

    With --policy no run is needed: that policy drives one episode after the other.
    """
    if page is not None and not browser:
        raise CommandError("--page is the port of the page that --browser serves: add --browser")
    if bind != LOOPBACK and serve is None and not browser:
        raise CommandError(f"--bind {bind} is where --serve and --browser listen: add one of them")
    if policy is not None:
        _require_alone(what, "--browser" if browser else "--serve" if serve is not None else None, save)
        _require_new(save, overwrite)
        _watch_policy(
            policy,
            _driven(town, vehicles),
            force or [],
            episodes,
            seed or 0,
            _server(serve, bind, browser, page),
            save,
        )
        return
    of_policy: dict[str, object] = {"town": town, "vehicles": vehicles, "force": force or None}
    of_policy |= {"episodes": episodes, "seed": seed, "save": save, "overwrite": overwrite or None}
    for option in (option for option, value in of_policy.items() if value is not None):
        raise CommandError(f"--{option} is for watching a policy without a run: add --policy")
    _require_actor_or_recording(what)
    role, name = ("actor", what) if what is not None else ("evaluator", "evaluator")
    with stop_on_signal() as stop:
        with needs("evaluator"):
            from athrl_evaluator.watching.watch import watch as draw_frames
            from athrl_evaluator.watching.watch import watch_recording
        server = _server(serve, bind, browser, page)
        if what is not None and what.endswith(".mcap"):
            watch_recording(Path(what), server=server, stop=stop)
            return
        draw_frames(connect=connect, run=run, role=role, name=name, server=server, stop=stop)


def _server(serve: int | None, bind: str, browser: bool, page: int | None) -> Server | None:
    """Where to serve viewers; None: a window is opened."""
    if serve is None and not browser:
        return None
    with needs("evaluator"):
        from athrl_evaluator.watching.viewer import PAGE_PORT, Server
    if not browser:
        return Server(serve or 0, bind)
    page = page or PAGE_PORT
    if serve == page:
        raise CommandError(f"--serve {serve} is the page's port, too: give --serve or --page another one")
    return Server(serve or page + 1, bind, page)


def _require_actor_or_recording(what: str | None) -> None:
    """Raise CommandError for a path that is neither a valid name of an actor nor a recording."""
    if what is None or what.endswith(".mcap"):
        return
    if "/" in what or Path(what).exists():
        raise CommandError(f"{what} is no recorded episode (FILE.mcap) and no actor's name")


def _require_alone(what: str | None, serving: str | None, save: Path | None) -> None:
    """Refuse options that cannot be used with --policy."""
    if what is not None:
        raise CommandError(f"{what} cannot be used with --policy, which needs no run: leave one out")
    if serving is not None and save is not None:
        raise CommandError(f"{serving} cannot be used with --save, which opens no viewer: leave one out")


def _require_new(save: Path | None, overwrite: bool) -> None:
    """Refuse to replace a file, unless that is asked for, and to ask for it without a file."""
    if save is None and overwrite:
        raise CommandError("--overwrite replaces the file of --save: add it")
    if save is not None and save.exists() and not overwrite:
        raise CommandError(f"--save {save}: exists already: name another file, or add --overwrite")


def _driven(town: str | None, vehicles: int | None) -> EnvironmentSection:
    """The settings of what a driver is watched in; raises CommandError where it cannot be driven."""
    given = {"towns": town, "vehicles": vehicles}
    for name in DEFAULTS.environment.towns if town is None else (town,):
        check_town(name, DEFAULTS.environment.vehicles if vehicles is None else vehicles)
    return EnvironmentSection.model_validate({k: v for k, v in given.items() if v is not None})


def _watch_policy(
    policy: str,
    section: EnvironmentSection,
    force: Sequence[str],
    episodes: int | None,
    seed: int,
    server: Server | None,
    save: Path | None,
) -> None:
    """Show a driver while it drives; a file gets one episode by default."""
    driver = find_driver(policy)
    with stop_on_signal() as stop:
        with needs("evaluator"):
            from athrl_evaluator.watching.watch_policy import watch_policy
        driven = watch_policy(
            driver,
            environment=section,
            forced=force,
            episodes=1 if episodes is None and save is not None else episodes,
            seed=seed,
            server=server,
            save=save,
            stop=stop,
        )
    if save is not None:
        print(f"{save}: {counted(driven, 'episode')} of {policy} in {', '.join(section.towns)}")
