"""The tables at the end of a run: the last policy and the reference drivers, over all towns and in each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from athrl_protocol.announcements.comparison import COMPARISON_FILE
from athrl_spaces.untrusted import UntrustedFile, parser_errors, read_json
from rich.markup import escape
from rich.table import Table

from athrl.errors import CommandError

# Column titles, their scores and formats.
_COLUMNS = (
    ("m/s", "speed_mps", "{:.2f}"),
    ("m", "distance_m", "{:.0f}"),
    ("collisions", "collision_rate", "{:.0%}"),
    ("off lane", "off_lane_rate", "{:.0%}"),
    ("full", "full_episode_rate", "{:.0%}"),
    ("score", "driving_score", "{:.2f}"),
)


def read_comparison(folder: Path, since: float) -> dict[str, Any]:
    """Return the closing comparison that the evaluator wrote into a run's folder.

    Raises:
        CommandError: there is none, or it is older than `since` (unix seconds).
    """
    file = folder / COMPARISON_FILE
    try:
        if file.stat().st_mtime >= since:
            with parser_errors(UntrustedFile):
                return dict(read_json(file))
    except (OSError, UntrustedFile):
        pass
    raise CommandError(f"the run is finished, but its closing comparison is missing: see {folder / 'logs'}")


def comparison_tables(comparison: dict[str, Any]) -> list[Table]:
    """Return a table with a row for each driver; with several towns first one table for each town."""
    with parser_errors(lambda reason: CommandError(f"the closing comparison cannot be shown: {reason}")):
        version, towns = comparison["policy_version"], comparison.get("towns", {})
        tables = [_table(version, f" in {town}", drivers) for town, drivers in towns.items()]
        return [*tables, _table(version, f" in {comparison['town']}" if towns else "", comparison["drivers"])]


def _table(version: int, where: str, drivers: dict[str, dict[str, float]]) -> Table:
    """Draw the scores of each driver; the return has its 95 % interval."""
    episodes = int(drivers["policy"]["episodes"])
    title = f"policy {int(version)} and others{escape(where)}, {episodes} episodes each, ± 95 %"
    table = Table(title=title, pad_edge=False)  # fits a terminal of 80 columns
    table.add_column("driver")
    table.add_column("return", justify="right")
    for title, _, _ in _COLUMNS:
        table.add_column(title, justify="right")
    for driver, scores in drivers.items():
        cells = [form.format(scores[name]) for _, name, form in _COLUMNS]
        table.add_row(escape(driver), f"{scores['return_mean']:.0f} ± {scores['return_ci95']:.0f}", *cells)
    return table
