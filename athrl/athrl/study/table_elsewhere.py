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

_SHARES = (("of_home", "of home"), ("of_rule_based", "of rule-based"))
"""Of the return: the first not of a case study, whose episodes are of another length."""


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
    """Return a row's means over the seeds that were scored, and their share of other returns."""
    found = {run.seed: folder.result(name_elsewhere(run.name, place)) for run in runs}
    scored = {seed: each for seed, each in found.items() if each is not None and not failed(each)}
    scores = estimates(scored.values(), "scores", SCORES)
    own = [folder.result(run.name) for run in runs if run.seed in scored]
    at_home = [result for result in own if result is not None and not failed(result)]
    home = estimates(at_home, "scores", ["return_mean"]).get("return_mean", {}).get("mean")
    return {
        **described(row),
        "seeds": [run.seed for run in runs],
        "scored": list(scored),
        "scores": scores,
        "of_home": _share(scores, home),
        "of_rule_based": _share(scores, rule_based),
    }


def _share(scores: Mapping[str, Any], of: float | None) -> float | None:
    """Return the mean return as a share of another; None where one is missing or the other not positive."""
    if of is None or of <= 0 or "return_mean" not in scores:
        return None
    return float(scores["return_mean"]["mean"] / of)


def markdown_elsewhere(places: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the table of each place, line by line."""
    for place in places:
        is_town = place["case_study"] is None
        columns = _COLUMNS if is_town else (*_COLUMNS, _SECONDS)
        shares = _SHARES if is_town else _SHARES[1:]
        yield from ["", f"### Elsewhere: {place['name']}", "", f"{_in_words(place)}", ""]
        titles = [text for _, text, _ in columns] + [text for _, text in shares]
        yield f"| {' | '.join(['planner', 'trained in', 'seeds', *titles])} |"
        yield f"|---|---|---:|{'---:|' * len(titles)}"
        for row in place["rows"]:
            cells = [cell(row["scores"].get(name), form) for name, _, form in columns]
            cells += [cell(row[name], "{:.2f}") for name, _ in shares]
            seeds = f"{len(row['scored'])} of {len(row['seeds'])}"
            yield f"| {' | '.join([title(row), row['town'], seeds, *cells])} |"
        for driver in place["drivers"]:
            scores = driver.get("scores", {})
            cells = [cell(scores.get(name), form) for name, _, form in columns]
            yield f"| {' | '.join([driver['driver'], '', '', *cells, *('' for _ in shares)])} |"


def _in_words(place: Mapping[str, Any]) -> str:
    """Say what is driven in a place."""
    episodes = f", {counted(place['episodes'], 'episode')}" if place["episodes"] is not None else ""
    if place["case_study"] is not None:
        return f"The case study {place['case_study']}{episodes}."
    vehicles = f" with {counted(place['vehicles'], 'vehicle')}" if place["vehicles"] is not None else ""
    return f"{place['town']}{vehicles}{episodes}."
