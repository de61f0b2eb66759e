"""`athrl maps` lists the towns; `athrl maps check FILE` looks at a map before anybody trains on it."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Annotated

import typer

from athrl.errors import CommandError, needs
from athrl.maps import report
from athrl.options import JsonOption
from athrl.output import console

maps = typer.Typer(help="List the included towns; check a map of your own.")


@maps.callback(invoke_without_command=True)
def list_towns(context: typer.Context, as_json: JsonOption = False) -> None:
    """List the included towns; `athrl maps check FILE` checks a map of your own."""
    if context.invoked_subcommand is not None:
        return
    with needs("actor"):
        from athrl_driving.inspection import facts_of, suggested_vehicles
        from athrl_driving.maps import TOWNS, load_town
        from athrl_spaces import RANDOM_TOWNS
    found = [load_town(name) for name in TOWNS]
    if as_json:
        towns = [report.plain(facts_of(town), suggested_vehicles(town)) for town in found]
        print(json.dumps({"towns": towns, "random_towns": RANDOM_TOWNS}))
        return
    for town in found:
        print(report.line_of(facts_of(town), suggested_vehicles(town)))
    print(f"{RANDOM_TOWNS}: a town drawn at random for each number; see athrl maps check random-7")


@maps.command()
def check(
    file: Annotated[str, typer.Argument(metavar="FILE|TOWN", help="OpenDRIVE file (.xodr), or a town.")],
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw the map into this file.")
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Refuse what the standard forbids, instead of mending it.")
    ] = False,
    vehicles: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="Background vehicles of the trial; by default as many as suggested."
        ),
    ] = None,
    drive: Annotated[
        bool, typer.Option("--drive/--no-drive", help="Let traffic drive for a minute, as a trial.")
    ] = True,
    as_json: JsonOption = False,
) -> None:
    """Say what a map holds, what of it is driven, and how traffic flows on it; refuse what cannot be used.

    The exit code is 0 for a map that can be driven, else 2, with one line that says why not.
    """
    if picture is not None:
        _check_picture(picture)
    logging.getLogger("athrl_driving.maps").setLevel(logging.ERROR)  # the report has what it would say
    with needs("actor"):
        from athrl_driving.inspection import draw_town, facts_of, suggested_vehicles, try_traffic
        from athrl_driving.maps import load_town
    town = load_town(file, strict=strict)
    facts, suggested = facts_of(town), suggested_vehicles(town)
    if vehicles is not None and vehicles > facts.driven.vehicle_places:
        raise CommandError(
            f"--vehicles {vehicles}: {facts.name} has room for {facts.driven.vehicle_places} at most"
        )
    if picture is not None:
        draw_town(town, picture)
    count = suggested if vehicles is None else vehicles
    trial = try_traffic(town, count) if drive and count else None
    if as_json:
        print(json.dumps(report.plain(facts, suggested, trial, picture)))
    else:
        console(soft_wrap=True).print(report.table(facts, suggested, trial, picture))


def _check_picture(picture: Path) -> None:
    """Refuse a file that could not be written before the map is looked at."""
    if picture.suffix.lower() != ".png":
        raise CommandError(f"--picture {picture}: its name should end in .png")
    if not picture.resolve().parent.is_dir():
        raise CommandError(f"--picture {picture}: there is no folder {picture.resolve().parent}")
