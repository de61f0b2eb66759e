"""The tables of the places of a study: what its policies are worth where they were not trained."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from athrl_spaces.wording import counted

from athrl.study.file import SCORES, ElsewhereSection, StudyFile
from athrl.study.folder import StudyFolder
from athrl.study.grid import name_elsewhere
from athrl.study.plan import PlannedRun, Row
from athrl.study.rows import by_row, cell, described, estimates, failed, title

_COLUMNS = (
    ("return_mean", "greedy return", "{:.0f}"),
    ("speed_mps", "m/s", "{:.2f}"),
    ("collision_rate", "collisions", "{:.1%}"),
    ("off_lane_rate", "off lane", "{:.1%}"),
    ("success_rate", "success", "{:.1%}"),
)
_SECONDS = ("success_seconds", "seconds to success", "{:.1f}")
"""Only of a case study: elsewhere a success lasts until the time is up."""


def tabulated_elsewhere(
    study: StudyFile, runs: Sequence[PlannedRun], folder: StudyFolder
) -> list[dict[str, Any]]:
    """Return for each place its rows over seeds and the reference drivers there, for `study.json`."""
    return [_place(study, section, runs, folder) for section in study.elsewhere]


def _place(
    study: StudyFile, section: ElsewhereSection, runs: Sequence[PlannedRun], folder: StudyFolder
) -> dict[str, Any]:
    names = [name_elsewhere(f"driver-{driver}", section.name) for driver in study.study.drivers]
    drivers = [found for name in names if (found := folder.result(name)) is not None]
    rule_based = next((each for each in drivers if each["driver"] == "rule-based" and not failed(each)), None)
    reference = rule_based["scores"]["return_mean"] if rule_based is not None else None
    rows = [_row(row, own, section.name, folder, reference) for row, own in by_row(runs)]
    failures = {f"{each['driver']} in {section.name}": each["failure"] for each in drivers if failed(each)}
    names = [name_elsewhere(run.name, section.name) for run in runs]
    scored = [found for name in names if (found := folder.result(name)) is not None]
    failures |= {f"{each['run']} in {section.name}": each["failure"] for each in scored if failed(each)}
    return {
        **section.model_dump(),
        "rows": rows,
        "drivers": drivers,
        "runs": scored,
        "failures": failures,
    }


def _row(
    row: Row, runs: Sequence[PlannedRun], place: str, folder: StudyFolder, rule_based: float | None
) -> dict[str, Any]:
    """Return a row's means over the seeds that were scored, and their share of the rule-based return."""
    found = {run.seed: folder.result(name_elsewhere(run.name, place)) for run in runs}
    scored = {seed: each for seed, each in found.items() if each is not None and not failed(each)}
    scores = estimates(scored.values(), "scores", SCORES)
    share = None
    if rule_based is not None and rule_based > 0 and "return_mean" in scores:
        share = scores["return_mean"]["mean"] / rule_based
    return {
        **described(row),
        "seeds": [run.seed for run in runs],
        "scored": list(scored),
        "scores": scores,
        "of_rule_based": share,
    }


def markdown_elsewhere(places: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the table of each place, line by line."""
    for place in places:
        yield from ["", f"### Elsewhere: {place['name']}", "", f"{_in_words(place)}", ""]
        columns = (*_COLUMNS, _SECONDS) if place["case_study"] is not None else _COLUMNS
        titles = ["planner", "trained in", "seeds", *(text for _, text, _ in columns), "of rule-based"]
        yield f"| {' | '.join(titles)} |"
        yield f"|---|---|{'---:|' * (len(titles) - 2)}"
        for row in place["rows"]:
            cells = [cell(row["scores"].get(name), form) for name, _, form in columns]
            seeds = f"{len(row['scored'])} of {len(row['seeds'])}"
            share = cell(row["of_rule_based"], "{:.2f}")
            yield f"| {' | '.join([title(row), row['town'], seeds, *cells, share])} |"
        for driver in place["drivers"]:
            scores = driver.get("scores", {})
            cells = [cell(scores.get(name), form) for name, _, form in columns]
            yield f"| {' | '.join([driver['driver'], '', '', *cells, ''])} |"


def _in_words(place: Mapping[str, Any]) -> str:
    """Say what is driven in a place."""
    episodes = f", {counted(place['episodes'], 'episode')}" if place["episodes"] is not None else ""
    if place["case_study"] is not None:
        return f"The case study {place['case_study']}{episodes}."
    vehicles = f" with {counted(place['vehicles'], 'vehicle')}" if place["vehicles"] is not None else ""
    return f"{place['town']}{vehicles}{episodes}."
