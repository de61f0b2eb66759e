"""`athrl record`: film a policy or a reference driver."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from athrl.errors import CommandError, needs
from athrl.evaluate.drivers import find_driver
from athrl.evaluate.places import check_town
from athrl.options import DEFAULTS, OverwriteOption
from athrl.stopping import stop_on_signal

STOPPED = 130
"""Exit code where a signal came before the video was complete."""

_SIZE = re.compile(r"(\d{1,5})x(\d{1,5})")


def record(
    policy: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE|random|blind|rule-based",
            help="The driver; `athrl policies` lists the names of shipped policies.",
        ),
    ],
    video: Annotated[Path, typer.Option(metavar="FILE.mp4", help="The video to write.")],
    town: Annotated[str, typer.Option(help="Town or map to drive in.")] = "town03",
    vehicles: Annotated[
        int, typer.Option(min=0, help="Background vehicles.")
    ] = DEFAULTS.environment.vehicles,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first episode.")] = 0,
    seconds: Annotated[float, typer.Option(min=1, max=3600, help="Length of the video.")] = 30.0,
    size: Annotated[
        str, typer.Option(metavar="WIDTHxHEIGHT", help="Pixels, both even, from 64 to 4096.")
    ] = "1280x720",
    overwrite: OverwriteOption = False,
) -> None:
    """Film a driver: the town around it in real time, as an MP4 file.

    Needs `pip install 'athrl[video]'`.
    """
    if video.suffix.lower() != ".mp4":
        raise CommandError(f"--video {video}: should end in .mp4")
    check_town(town, vehicles)
    driver = find_driver(policy, option="")
    with needs("video"):
        from athrl_evaluator.scoring.episodes import Stopped
        from athrl_evaluator.video import LARGEST_SIZE, SMALLEST_SIZE, Shot, film
    shot = Shot(town, vehicles, seed, seconds, _pixels(size, SMALLEST_SIZE, LARGEST_SIZE))
    with stop_on_signal() as stop:
        try:
            pictures = film(driver, shot, video, stop, overwrite=overwrite)
        except Stopped:
            raise typer.Exit(STOPPED) from None
    print(f"{video}: {pictures} pictures, {seconds:g} s of {policy} in {town}")


def _pixels(size: str, smallest: int, largest: int) -> tuple[int, int]:
    """Read WIDTHxHEIGHT."""
    given = _SIZE.fullmatch(size)
    sides = tuple(map(int, given.groups())) if given else ()
    if len(sides) != 2 or not all(smallest <= side <= largest and side % 2 == 0 for side in sides):
        raise CommandError(
            f"--size {size}: should be WIDTHxHEIGHT, both even and from {smallest} to {largest}, as 1280x720"
        )
    return sides[0], sides[1]
