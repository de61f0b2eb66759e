"""The tables of `benchmarks.tables`, read from the files in benchmarks/results and checked.

Each `benchmarks/results/SUBJECT.json` is one table:

    subject, section, title, question   texts; section is one of SECTIONS, subject the file's name
    columns, rows                       column names; rows of texts, numbers and null
    command, peer, goal, machine        optional texts: how to repeat it, compared with what, what is aimed at
    commit, date                        optional: where the figures were written down
    page                                optional: the page that explains it, a path in docs
    notes                               optional list of texts

`default-run.json`, `hierarchy/*.json` and `peers-*.json` are what the benchmarks of these names print; when
and where they were measured is in `raw.json`.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RESULTS = Path("benchmarks/results")
SECTIONS = ("Driving", "Learning", "Experience on its way", "Durability")
LONGEST_TEXT, LONGEST_CELL = 120, 60  # characters: a longer one is an explanation, which belongs on a page

_REQUIRED = ("subject", "section", "title", "question", "columns", "rows")
_OPTIONAL_TEXTS = ("command", "peer", "goal", "machine", "page")
_MEASURED = ("commit", "date", "machine", "notes")  # what raw.json may say of a raw file
_COMMIT, _DATE = re.compile(r"[0-9a-f]{7,40}"), re.compile(r"\d{4}-\d\d-\d\d")
_FORCED = ("left", "straight on", "right")

Cell = str | int | float | None


class ResultsError(ValueError):
    """A file of results is not what it should be; `str()` is one line: file, key, what it should be."""

    def __init__(self, file: Path, key: str, should: str) -> None:
        super().__init__(f"{file.as_posix()}: {key}: should be {should}")


@dataclass(frozen=True)
class Table:
    """One subject's figures and where they come from; every row has a cell for each column."""

    subject: str
    section: str
    title: str
    question: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    command: str | None = None
    peer: str | None = None
    goal: str | None = None
    machine: str | None = None
    commit: str | None = None
    date: str | None = None
    page: str | None = None
    notes: Sequence[str] = ()


def read_tables(root: Path) -> dict[str, Table]:
    """Every subject's table of the repository at `root`, in the order of the page.

    Raises `ResultsError` for a file that cannot be read, is not JSON or has a wrong key or value.
    """
    folder = RESULTS
    measured = _measured(root, folder / "raw.json")
    tables: list[Table] = []
    for path in sorted((root / folder).glob("*.json")):
        file = folder / path.name
        if path.name == "raw.json":
            continue
        if path.stem == "default-run":
            tables.append(_default_run(file, _load(root, file), measured.get(path.stem, {})))
        elif path.stem.startswith("peers-"):
            tables.append(_peers(file, _load(root, file), measured.get(path.stem, {})))
        else:
            tables.append(_table(file, _load(root, file)))
    trials = [
        folder / "hierarchy" / path.name for path in sorted((root / folder / "hierarchy").glob("*.json"))
    ]
    if trials:
        loaded = {file: _load(root, file) for file in trials}
        tables.append(_hierarchy(loaded, measured.get("hierarchy", {})))
    tables.sort(key=lambda table: (SECTIONS.index(table.section), _natural(table.subject)))
    return {table.subject: table for table in tables}


def _natural(subject: str) -> list[tuple[int, str]]:
    """Sorts peers-5 before peers-25."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", subject)]


def _load(root: Path, file: Path) -> dict[str, Any]:
    try:
        content = json.loads((root / file).read_text(encoding="utf-8"))
    except (OSError, ValueError) as reason:
        line = " ".join(str(reason).split())
        raise ResultsError(file, "file", f"readable JSON ({line})") from None
    if not isinstance(content, dict):
        raise ResultsError(file, "file", "one JSON object")
    return content


def _table(file: Path, content: Mapping[str, Any]) -> Table:
    """A table of the form that the module's text describes."""
    known = {*_REQUIRED, *_OPTIONAL_TEXTS, *_MEASURED}
    for key in content:
        if key not in known:
            raise ResultsError(file, key, f"one of {', '.join(sorted(known))}")
    for key in _REQUIRED:
        if key not in content:
            raise ResultsError(file, key, "there")
    for key in ("title", "question", *_OPTIONAL_TEXTS):
        if key in content:
            _check_text(file, key, content[key], LONGEST_TEXT)
    if content["subject"] != file.stem:
        raise ResultsError(file, "subject", f"the file's name, {file.stem}")
    if content["section"] not in SECTIONS:
        raise ResultsError(file, "section", f"one of {', '.join(SECTIONS)}")
    columns, rows = content["columns"], content["rows"]
    if not isinstance(columns, list) or len(columns) < 2:
        raise ResultsError(file, "columns", "a list of two texts or more")
    for index, column in enumerate(columns):
        _check_text(file, f"columns[{index}]", column, LONGEST_CELL)
    if not isinstance(rows, list) or not rows:
        raise ResultsError(file, "rows", "a list of one row or more")
    for index, row in enumerate(rows):
        _check_row(file, f"rows[{index}]", row, len(columns))
    _check_measured(file, "", content)
    return Table(**content)


def _check_row(file: Path, key: str, row: object, columns: int) -> None:
    if not isinstance(row, list) or len(row) != columns:
        raise ResultsError(file, key, f"a list of {columns} cells, one a column")
    for index, cell in enumerate(row):
        if isinstance(cell, str):
            _check_text(file, f"{key}[{index}]", cell, LONGEST_CELL)
        elif cell is not None and not _is_number(cell):
            raise ResultsError(file, f"{key}[{index}]", "a text, a finite number or null")


def _check_text(file: Path, key: str, text: object, longest: int) -> None:
    if not isinstance(text, str) or not 0 < len(text) <= longest or "|" in text or "\n" in text:
        raise ResultsError(file, key, f"a text of 1 to {longest} characters without | and line ends")


def _check_measured(file: Path, within: str, content: Mapping[str, Any]) -> None:
    """Commit, date and notes, each where it is there; `within` is the path of keys to them."""
    commit, date, notes = content.get("commit"), content.get("date"), content.get("notes", [])
    if commit is not None and not (isinstance(commit, str) and _COMMIT.fullmatch(commit)):
        raise ResultsError(file, f"{within}commit", "7 to 40 hexadecimal digits")
    if date is not None and not (isinstance(date, str) and _DATE.fullmatch(date)):
        raise ResultsError(file, f"{within}date", "a date such as 2026-11-29")
    if not isinstance(notes, list):
        raise ResultsError(file, f"{within}notes", "a list of texts")
    for index, note in enumerate(notes):
        _check_text(file, f"{within}notes[{index}]", note, LONGEST_TEXT)


def _measured(root: Path, file: Path) -> dict[str, dict[str, Any]]:
    """When and where each raw file was measured."""
    if not (root / file).exists():
        return {}
    content = _load(root, file)
    for subject, facts in content.items():
        if not isinstance(facts, dict) or not set(facts) <= set(_MEASURED):
            raise ResultsError(file, subject, f"an object with some of {', '.join(_MEASURED)}")
        _check_measured(file, f"{subject}.", facts)
        if "machine" in facts:
            _check_text(file, f"{subject}.machine", facts["machine"], LONGEST_TEXT)
    return content


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


# What benchmarks print


def _default_run(file: Path, facts: Mapping[str, Any], measured: Mapping[str, Any]) -> Table:
    """`benchmarks.default_run`: every seed beside the rule-based driver."""
    rule_based, runs = _object(file, facts, "rule_based"), _object(file, facts, "runs")
    if not runs:
        raise ResultsError(file, "runs", "an object with one seed or more")
    scored = {f"policy, seed {seed}": (_object(file, runs, seed, "runs."), f"runs.{seed}") for seed in runs}
    decisions, updates = (
        max(_number(file, run, within, key) for run, within in scored.values())
        for key in ("decisions", "updates")
    )
    scored |= {"mean": (_object(file, facts, "mean"), "mean"), "rule-based": (rule_based, "rule_based")}
    bar = _number(file, rule_based, "rule_based", "return_mean")
    rows: list[list[Cell]] = []
    for driver, (scores, within) in scored.items():
        share = f"{_number(file, scores, within, 'return_mean') / bar:.2f}"
        rows.append([driver, _return(file, scores, within), share, *_shares(file, scores, within)])
    episodes, first_seed = (_number(file, facts, "", key) for key in ("episodes", "first_seed"))
    return Table(
        subject="default-run",
        section="Learning",
        title="Default run",
        question=f"What does `athrl train` learn with {decisions:,.0f} decisions and {updates:,.0f} updates?",
        columns=["driver", "return", "of rule-based", "collisions", "off lane", "full episodes"],
        rows=rows,
        command=f"python -m benchmarks.default_run --seeds {' '.join(runs)}{_set(facts.get('settings'))}",
        peer=f"the rule-based driver on the same {episodes:.0f} episodes from seed {first_seed:.0f}, ± 95 %",
        goal="1.04 times the rule-based return, at most 2 % collisions and lane exits, in 10 minutes",
        **measured,
    )


def _hierarchy(trials: Mapping[Path, Mapping[str, Any]], measured: Mapping[str, Any]) -> Table:
    """`benchmarks.hierarchy`: a row for each variant and seed; only atHRL has an intention to force."""
    rows: list[list[Cell]] = []
    asked: dict[str, dict[str, None]] = {"variants": {}, "seeds": {}, "decisions": {}}
    for file, facts in trials.items():
        free = _object(file, facts, "free")
        seed, decisions = (_number(file, facts, "", key) for key in ("seed", "decisions"))
        row: list[Cell] = [file.stem.rpartition("-")[0], int(seed), int(decisions)]
        for known, cell in zip(asked.values(), row, strict=True):
            known[str(cell)] = None
        row += [_return(file, free, "free"), *_shares(file, free, "free")[:2]]
        if f"forced {_FORCED[0]}" in facts:
            for way in _FORCED:
                key = f"forced {way}"
                row.append(f"{_number(file, _object(file, facts, key), key, 'return_mean'):.0f}")
            row.append(f"{_number(file, facts, '', 'change_of_target_speed'):.1f}")
            row.append(f"{math.degrees(_number(file, facts, '', 'change_of_waypoint_angle')):.1f}")
            row.append(f"{_number(file, facts, '', 'intention_deviation'):.2f}")
        else:
            row += [None] * (len(_FORCED) + 3)
        rows.append(row)
    options = [f"--{name} {' '.join(values)}" for name, values in asked.items()]
    return Table(
        subject="hierarchy",
        section="Learning",
        title="What the hierarchy brings",
        question="How does each variant of atHRL drive, free and with its intention forced to a side?",
        columns=[
            *("variant", "seed", "decisions", "return, free", "collisions", "off lane"),
            *("return, left", "ahead", "right"),
            *("left to right: speed, m/s", "waypoint, degrees", "free intention, deviation"),
        ],
        rows=rows,
        command=" ".join(["python -m benchmarks.hierarchy", *options]),
        page="explanation/planners.md",
        **measured,
    )


def _peers(file: Path, facts: Mapping[str, Any], measured: Mapping[str, Any]) -> Table:
    """`benchmarks.peers`: everybody who was compared, and the rule-based driver."""
    from benchmarks.peers.chart import TITLES  # only here, as it loads matplotlib
    from benchmarks.peers.installation import PEER_OF

    bar = _number(file, _object(file, facts, "rule_based"), "rule_based", "return_mean")
    rows: list[list[Cell]] = []
    for name in [*(name for name in TITLES if name in facts), "rule_based"]:
        scores, title = _object(file, facts, name), TITLES.get(name, "rule-based driver")
        if "error" in scores:
            rows.append([title, "failed", *[None] * 6])
            continue
        spent: list[Cell] = [None, None]
        if name != "rule_based":
            spent = [round(_number(file, scores, name, key)) for key in ("decisions", "seconds")]
        share = f"{_number(file, scores, name, 'return_mean') / bar:.2f}"
        rows.append([title, *spent, _return(file, scores, name), share, *_shares(file, scores, name)])
    minutes = _number(file, facts, "", "seconds") / 60
    episodes, cores, seed = (_number(file, facts, "", key) for key in ("episodes", "cores", "seed"))
    libraries = ", ".join(f"{name} {number}" for name, number in _object(file, facts, "libraries").items())
    how = facts.get("ours", {}).get("how")
    others = [library for library, peer in PEER_OF.items() if peer in facts]
    columns = ["planner", "decisions", "seconds", "return", "of rule-based"]
    return Table(
        subject=file.stem,
        section="Learning",
        title=f"Beside other libraries, {minutes:g} minutes",
        question=f"What does each learn in {minutes:g} minutes on the same {cores:.0f} cores, scored on "
        f"{episodes:.0f} held-out episodes (± 95 %)?",
        columns=[*columns, "collisions", "off lane", "full episodes"],
        rows=rows,
        command=f"python -m benchmarks.peers --minutes {minutes:g} --cores {cores:.0f} --seed {seed:.0f}"
        + (f" --with {','.join(others)}" if others else "")
        + _set(how.get("settings") if isinstance(how, dict) else None),
        page="peers.md",
        **{"machine": _text(file, facts, "processor"), "notes": [f"{libraries}."], **measured},
    )


def _set(settings: object) -> str:
    """The options `--set` of a command; nothing for what is no list of settings."""
    return "".join(f" --set {each}" for each in settings) if isinstance(settings, list) else ""


def _text(file: Path, facts: Mapping[str, Any], key: str) -> str:
    _check_text(file, key, found := facts.get(key), LONGEST_TEXT)
    return str(found)


def _object(file: Path, facts: Mapping[str, Any], key: str, within: str = "") -> Mapping[str, Any]:
    found = facts.get(key)
    if not isinstance(found, dict):
        raise ResultsError(file, f"{within}{key}", "a JSON object")
    return found


def _number(file: Path, facts: Mapping[str, Any], within: str, key: str) -> float:
    found = facts.get(key)
    if not _is_number(found):
        raise ResultsError(file, f"{within}.{key}".lstrip("."), "a finite number")
    return found


def _return(file: Path, scores: Mapping[str, Any], within: str) -> str:
    mean = f"{_number(file, scores, within, 'return_mean'):.0f}"
    if "return_ci95" not in scores:  # a mean over seeds has none
        return mean
    return f"{mean} ± {_number(file, scores, within, 'return_ci95'):.0f}"


def _shares(file: Path, scores: Mapping[str, Any], within: str) -> list[Cell]:
    """Collisions, lane exits and full episodes in percent."""
    keys = ("collision_rate", "off_lane_rate", "full_episode_rate")
    return [f"{100 * _number(file, scores, within, key):.1f} %" for key in keys]
