"""What the tables of a study are made of: rows over seeds, estimates and their cells."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any

from athrl.study.plan import PlannedRun, Row
from athrl.study.statistics import estimate


def by_row(runs: Sequence[PlannedRun]) -> list[tuple[Row, list[PlannedRun]]]:
    """Return the runs of each row in the order of their seeds."""
    rows = list(dict.fromkeys(run.row for run in runs))
    ordered = sorted(runs, key=lambda run: (rows.index(run.row), run.seed))
    return [(row, list(own)) for row, own in groupby(ordered, key=lambda run: run.row)]


def described(row: Row) -> dict[str, str]:
    """Return what a row is, for `study.json`."""
    return {"planner": row.planner, "town": row.town, "variant": row.variant}


def estimates(finished: Iterable[Mapping[str, Any]], kind: str, names: Sequence[str]) -> dict[str, Any]:
    """Return the estimate of each value that the results have under `kind`."""
    found = {name: [run[kind][name] for run in finished if name in run[kind]] for name in names}
    return {name: estimate([values]).as_dict() for name, values in found.items() if values}


def failed(result: Mapping[str, Any]) -> bool:
    """Whether a run or an evaluation ended with an error."""
    return "failure" in result


def title(row: Mapping[str, Any]) -> str:
    """Return the planner of a row with its variant."""
    return f"{row['planner']}, {row['variant']}" if row["variant"] else str(row["planner"])


def cell(value: Any, form: str) -> str:
    """Return a number, or an estimate with its interval, for a cell; empty without one."""
    if value is None:
        return ""
    if not isinstance(value, Mapping):
        return form.format(value)
    mean = form.format(value["mean"])
    if value["low"] is None:
        return mean
    return f"{mean} [{form.format(value['low'])}, {form.format(value['high'])}]"
