"""The table of a study: its rows over seeds, the reference drivers, and what failed; Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from athrl.study.file import SCORES, PublishedSection, StudyFile
from athrl.study.folder import StudyFolder
from athrl.study.grid import driver_name
from athrl.study.plan import PlannedRun, Row
from athrl.study.rows import by_row, cell, described, estimates, failed, title
from athrl.study.statistics import estimate
from athrl.study.table_elsewhere import markdown_elsewhere, tabulated_elsewhere

TRAINING = ("return_mean", "speed_mps")

_COLUMNS = (
    ("training", "return_mean", "training return", "{:.0f}"),
    ("training", "speed_mps", "training m/s", "{:.2f}"),
    ("published", "return_mean", "published return", "{:.0f}"),
    ("published", "speed_mps", "published m/s", "{:.2f}"),
    ("scores", "return_mean", "greedy return", "{:.0f}"),
    ("scores", "speed_mps", "m/s", "{:.2f}"),
    ("scores", "collision_rate", "collisions", "{:.1%}"),
    ("scores", "off_lane_rate", "off lane", "{:.1%}"),
    ("scores", "full_episode_rate", "full", "{:.1%}"),
)


def tabulated(study: StudyFile, runs: Sequence[PlannedRun], folder: StudyFolder) -> dict[str, Any]:
    """Return all that a study has found so far, for `study.json`."""
    results = {run.name: folder.result(run.name) for run in runs}
    rows = [_row(study, row, own, results) for row, own in by_row(runs)]
    elsewhere = tabulated_elsewhere(study, runs, folder)
    towns = list(dict.fromkeys(run.row.town for run in runs))
    drivers = [
        found
        for town in towns
        for driver in study.study.drivers
        if (found := folder.result(driver_name(driver, town))) is not None
    ]
    ended = {**results} | {f"{found['driver']} in {found['town']}": found for found in drivers}
    return {
        "study": study.study.name,
        "title": study.study.title or study.study.name,
        "scoring": study.scoring.model_dump(),
        "rows": rows,
        "over_towns": _over_towns(rows),
        "drivers": drivers,
        "elsewhere": elsewhere,
        "failures": {
            name: found["failure"] for name, found in ended.items() if found is not None and failed(found)
        }
        | {name: said for place in elsewhere for name, said in place["failures"].items()},
        "runs": [found for found in results.values() if found is not None],
    }


def _row(
    study: StudyFile, row: Row, runs: Sequence[PlannedRun], results: Mapping[str, dict[str, Any] | None]
) -> dict[str, Any]:
    """Return a row's means over its finished seeds."""
    found = [result for run in runs if (result := results[run.name]) is not None]
    finished = [result for result in found if not failed(result)]
    seconds = [result["seconds"] for result in finished if result["seconds"] is not None]
    return {
        **described(row),
        "seeds": [run.seed for run in runs],
        "finished": [result["seed"] for result in finished],
        "failed": [result["seed"] for result in found if failed(result)],
        "decisions": runs[0].settings.run.environment_steps,
        "seconds": round(sum(seconds) / len(seconds), 1) if seconds else None,
        "training": estimates(finished, "training", TRAINING),
        "published": _published(study.published, row),
        "scores": estimates(finished, "scores", SCORES),
    }


def _published(published: Iterable[PublishedSection], row: Row) -> dict[str, float]:
    """Return the figures that others published for a row; a variant of ours has none."""
    for each in published:
        if (each.planner, each.town) == (row.planner, row.town) and not row.variant:
            return {name: getattr(each, name) for name in TRAINING if getattr(each, name) is not None}
    return {}


def _over_towns(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return each planner's mean return over its towns, the seeds of each town drawn by themselves."""
    found: list[dict[str, Any]] = []
    for planner, variant in dict.fromkeys((row["planner"], row["variant"]) for row in rows):
        own = [row for row in rows if (row["planner"], row["variant"]) == (planner, variant)]
        strata = [
            row["scores"]["return_mean"]["values"] for row in own if row["finished"] == row["seeds"] != []
        ]
        if len(own) > 1 and len(strata) == len(own):
            towns = [row["town"] for row in own]
            mean = estimate(strata).as_dict()
            found.append({"planner": planner, "variant": variant, "towns": towns, "return_mean": mean})
    return found


def markdown(found: Mapping[str, Any]) -> str:
    """Return the table of what `tabulated` returned, as Markdown, with a list of what failed below it."""
    columns = [
        column
        for column in _COLUMNS
        if any(column[1] in row[column[0]] for row in found["rows"]) or column[0] == "scores"
    ]
    titles = ["planner", "town", "seeds", *(title for _, _, title, _ in columns), "minutes a run"]
    lines = [f"| {' | '.join(titles)} |", f"|---|---|{'---:|' * (len(titles) - 2)}"]
    for row in found["rows"]:
        seeds = f"{len(row['finished'])} of {len(row['seeds'])}"
        cells = [cell(row[kind].get(name), form) for kind, name, _, form in columns]
        minutes = f"{row['seconds'] / 60:.1f}" if row["seconds"] is not None else ""
        lines.append(f"| {' | '.join([title(row), row['town'], seeds, *cells, minutes])} |")
    for driver in found["drivers"]:
        scores = driver.get("scores", {})
        cells = [
            cell(scores.get(name) if kind == "scores" else None, form) for kind, name, _, form in columns
        ]
        lines.append(f"| {' | '.join([driver['driver'], driver['town'], '', *cells, ''])} |")
    lines += [*_below(found), *markdown_elsewhere(found.get("elsewhere", []))]
    return "\n".join(lines) + "\n"


def _below(found: Mapping[str, Any]) -> list[str]:
    """Return the means over towns and the failures, as lines of Markdown."""
    said = []
    for each in found["over_towns"]:
        mean = cell(each["return_mean"], "{:.0f}")
        said.append(f"- {title(each)} over {', '.join(each['towns'])}: greedy return {mean}")
    said += [f"- {name} failed: {failure}" for name, failure in found["failures"].items()]
    return ["", *said] if said else []


def as_csv(found: Mapping[str, Any]) -> str:
    """Return every run, failed ones too, as a line of CSV with its training averages and scores."""
    text = io.StringIO()
    names = [*(f"training_{name}" for name in TRAINING), *SCORES]
    head = ["run", "planner", "town", "variant", "seed", "decisions", "seconds", *names, "failure"]
    writer = csv.DictWriter(text, head, restval="", extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for run in found["runs"]:
        training = {f"training_{name}": value for name, value in run.get("training", {}).items()}
        writer.writerow({**run, **training, **run.get("scores", {})})
    return text.getvalue()
