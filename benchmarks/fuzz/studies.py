"""Files of studies."""

from __future__ import annotations

from pathlib import Path

from athrl.errors import CommandError
from athrl.study.file import read_study_file
from athrl.study.plan import planned_runs, require_search
from athrl_planners.registry import settings_tables
from athrl_protocol.run_file import declare_planners

from benchmarks.fuzz import mutations
from benchmarks.fuzz.frame import Parser, file_parser

STUDIES = Path(__file__).parents[2] / "studies"


def study(folder: Path) -> Parser:
    """Return the parser of studies; a proper one has its run files beside it."""
    declare_planners(settings_tables())
    seeds = [
        path.read_bytes().replace(b'"../', f'"{STUDIES.parent}/'.encode()) for path in STUDIES.glob("*.toml")
    ]
    return file_parser(sorted(seeds), mutations.TEXT, folder / "study.toml", _read, CommandError)


def _read(path: Path) -> None:
    found = read_study_file(path)
    planned_runs(path, found)
    if found.search is not None:
        require_search(path, found)
