"""The tables at a run's end: the last policy beside the reference drivers, over all towns and in each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich.table import Table

from athrl.errors import CommandError

# Column titles, the scores they show, and how.
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
        CommandError: there is none, or only one from before `since` (unix seconds).
    """
    file = folder / "evaluation.json"
    try:
        if file.stat().st_mtime >= since:
            return dict(json.loads(file.read_text()))
    except (OSError, ValueError):
        pass
    raise CommandError(f"the run is finished, but its closing comparison is missing: see {folder / 'logs'}")


def compared_decisions(folder: Path) -> int:
    """Return after how many decisions a run's closing comparison was made; 0 where there is none."""
    try:
        return int(json.loads((folder / "evaluation.json").read_text())["environment_steps"])
    except (OSError, ValueError, KeyError, TypeError):  # not there, or not what a run writes
        return 0


def comparison_tables(comparison: dict[str, Any]) -> list[Table]:
    """Return a table with a row a driver; where there are several towns, one for each before that for all."""
    version, towns = comparison["policy_version"], comparison.get("towns", {})
    tables = [_table(version, f" in {town}", drivers) for town, drivers in towns.items()]
    return [*tables, _table(version, f" in {comparison['town']}" if towns else "", comparison["drivers"])]


def _table(version: int, where: str, drivers: dict[str, dict[str, float]]) -> Table:
    """Draw the scores of each driver; the return has its 95 % interval."""
    episodes = int(drivers["policy"]["episodes"])
    title = f"policy {version} and others{where}, {episodes} episodes each, ± 95 %"
    table = Table(title=title, pad_edge=False)  # fits a terminal of 80 columns
    table.add_column("driver")
    table.add_column("return", justify="right")
    for title, _, _ in _COLUMNS:
        table.add_column(title, justify="right")
    for driver, scores in drivers.items():
        cells = [form.format(scores[name]) for _, name, form in _COLUMNS]
        table.add_row(driver, f"{scores['return_mean']:.0f} ± {scores['return_ci95']:.0f}", *cells)
    return table
