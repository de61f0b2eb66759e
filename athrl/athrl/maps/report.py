"""What `athrl maps` says about a map, as lines for people or as plain values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from athrl_spaces.wording import counted
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from athrl_driving.inspection import MapFacts, Trial

_CRAWLS = 0.4
"""Share of free flow below which traffic is too dense to learn from."""


def line_of(facts: MapFacts, suggested: int) -> str:
    """Return one line about a town that comes along."""
    from athrl_driving.inspection.lines import extent, junctions

    return (
        f"{facts.name}: {facts.lane_kilometres:.1f} km of lanes on {extent(facts)}; "
        f"{junctions(facts)}; dense traffic: {counted(suggested, 'vehicle')}"
    )


def plain(
    facts: MapFacts, suggested: int, trial: Trial | None = None, picture: Path | None = None
) -> dict[str, Any]:
    """Return the report as plain values; `trial` and `picture` are null where there is none."""
    return {
        **asdict(facts),
        "suggested_vehicles": suggested,
        "trial": None if trial is None else asdict(trial),
        "picture": None if picture is None else str(picture),
    }


def table(facts: MapFacts, suggested: int, trial: Trial | None, picture: Path | None) -> Table:
    """Return the report as a table of names and lines."""
    result = Table(title=facts.name, show_header=False, title_justify="left")
    result.add_column(no_wrap=True)
    result.add_column()
    for name, line in _lines(facts, suggested, trial, picture):
        result.add_row(name, Text(line))
    return result


def _lines(
    facts: MapFacts, suggested: int, trial: Trial | None, picture: Path | None
) -> Iterator[tuple[str, str]]:
    from athrl_driving.inspection.lines import lines_of

    yield from lines_of(facts)
    yield "vehicles", _vehicles(facts, suggested)
    if trial is not None:
        yield "trial", _trial(trial)
        yield from (("warning", line) for line in _warnings(trial))
    if picture is not None:
        yield "picture", str(picture)


def _vehicles(facts: MapFacts, suggested: int) -> str:
    room = facts.driven.vehicle_places
    if not room:
        return "no room for background vehicles"
    return f"dense traffic that flows: {suggested:,}; there is room for {room:,}"


def _trial(trial: Trial) -> str:
    return (
        f"{counted(trial.vehicles, 'vehicle')} for {trial.seconds:.0f} s: {trial.mean_speed:.1f} m/s, "
        f"{trial.share_of_free_flow:.0%} of free flow; they stand {trial.standing:.0%} of the time"
    )


def _warnings(trial: Trial) -> Iterator[str]:
    if trial.overlap_seconds:
        yield f"vehicles collide: pairs of them overlap for {trial.overlap_seconds:.1f} s"
    if trial.stuck:
        vehicles = counted(trial.stuck, "vehicle")
        yield f"deadlock: at the end {vehicles} had been standing for more than {trial.patience:.0f} s"
    if trial.share_of_free_flow < _CRAWLS:
        yield "traffic crawls: try fewer with --vehicles"
