"""The runs of a study, each with its whole settings, checked before anything is started."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path, PurePath

from athrl_protocol import RunFileError
from athrl_protocol.run_file import RunFile, read_run_file
from athrl_protocol.run_file.planner_tables import kind_error
from athrl_protocol.run_file.toml_values import show, to_toml_value
from athrl_spaces import town_seed

from athrl.errors import CommandError, needs
from athrl.study.file import MOST_RUNS, GridSection, StudyFile, StudyFileError, filled, numbered

_FIXED = ("run.name", "run.folder", "run.seed", "planner.kind", "environment.towns", "network.listen")
"""Settings that the study gives each run itself."""


@dataclass(frozen=True)
class Row:
    """What the seeds of a study repeat: a line of its table."""

    planner: str
    towns: tuple[str, ...]
    variant: str

    @property
    def town(self) -> str:
        """The towns in one word, such as `town02+town04` or `town03+random-1..9`."""
        return "+".join(_shortened(self.towns))


@dataclass(frozen=True)
class PlannedRun:
    """One run of a study.

    Attributes:
        name: of the run and of its folder, unique in the study.
        row: what it belongs to.
        run_file: file with its settings, if one is named.
        overrides: `section.key=value`, all but its folder and its address.
        settings: what both together say.
    """

    name: str
    row: Row
    seed: int
    run_file: Path | None
    overrides: tuple[str, ...]
    settings: RunFile

    @property
    def recipe(self) -> dict[str, object]:
        """What makes it this run and no other, as it is kept in the study's folder."""
        file = self.run_file.read_bytes() if self.run_file is not None else None
        checksum = hashlib.sha256(file).hexdigest() if file is not None else None
        return {"settings": list(self.overrides), "run_file": checksum}


def planned_runs(path: Path, study: StudyFile, prefix: str = "") -> list[PlannedRun]:
    """Return the runs of a study, a seed after the other: all rows have their first before any a second.

    The planners must have been declared. Every name begins with `prefix`.

    Raises:
        StudyFileError: a planner, a town, a run file or a setting is not valid, or a run appears twice.
    """
    count = sum(_count(study, grid) for grid in study.grid)
    if count > MOST_RUNS:
        raise StudyFileError(f"{path}: has {count:,} runs, should have at most {MOST_RUNS:,}")
    found: list[tuple[int, PlannedRun]] = []
    for number, grid in enumerate(study.grid):
        found += _of_grid(f"{path}: {numbered('grid', number)}", path.parent, study, grid, prefix)
    runs = [run for _, run in sorted(found, key=lambda each: each[0])]
    _require_different(path, runs)
    return runs


def _count(study: StudyFile, grid: GridSection) -> int:
    seeds = grid.seeds or study.study.seeds
    return len(grid.planners) * len(grid.towns) * len(grid.variants) * len(seeds)


def _of_grid(
    place: str, folder: Path, study: StudyFile, grid: GridSection, prefix: str
) -> Iterator[tuple[int, PlannedRun]]:
    """Yield the runs of one grid, each with the place of its seed among the seeds."""
    for planner in grid.planners:
        wrong = kind_error(planner)
        if wrong is not None:
            raise StudyFileError(f"{place}, planners: {show(planner)}: {wrong}")
    for town in dict.fromkeys(town for towns in grid.towns for town in towns):
        require_town(f"{place}, towns", town)
    for towns in grid.towns:
        for planner in grid.planners:
            for variant, changes in grid.variants.items():
                row = Row(planner, tuple(towns), variant)
                given = [*study.study.settings, *grid.settings, *changes]
                _require_free(place, given)
                for order, seed in enumerate(grid.seeds or study.study.seeds):
                    name = prefix + run_name(row, seed)
                    yield order, _planned(name, place, folder, grid, row, seed, given)


def _planned(
    name: str, place: str, folder: Path, grid: GridSection, row: Row, seed: int, given: Sequence[str]
) -> PlannedRun:
    own = {
        "run.name": name,
        "run.seed": seed,
        "planner.kind": row.planner,
        "environment.towns": list(row.towns),
    }
    overrides = (*(f"{key}={to_toml_value(value)}" for key, value in own.items()), *given)
    run_file = None
    if grid.run_file is not None:
        run_file = folder / filled(grid.run_file, planner=row.planner, town=_label(row))
    try:
        settings = read_run_file(run_file, overrides)
    except RunFileError as error:
        raise StudyFileError(f"{place}: {error}") from None
    return PlannedRun(name, row, seed, run_file, overrides, settings)


def run_name(row: Row, seed: int) -> str:
    """Return the name of a run, of its row and seed."""
    parts = [row.planner, _label(row), *([row.variant] if row.variant else []), str(seed)]
    return re.sub(r"[^a-z0-9_-]", "-", "-".join(parts).lower())


def _label(row: Row) -> str:
    return "+".join(_shortened([PurePath(town).stem for town in row.towns]))


def _shortened(towns: Sequence[str]) -> list[str]:
    """Return the towns' names; random towns whose numbers follow each other are one, `random-1..9`."""

    def together(place_and_name: tuple[int, str]) -> object:
        place, name = place_and_name
        seed = town_seed(name)
        return name if seed is None else seed - place

    found: list[str] = []
    for _, group in groupby(enumerate(towns), together):
        names = [name for _, name in group]
        found.append(names[0] if len(names) == 1 else f"{names[0]}..{town_seed(names[-1])}")
    return found


def require_town(place: str, town: str) -> None:
    """Raise StudyFileError for a town that is none; `place` is what names it in the file."""
    with needs("evaluator"):
        from athrl_driving.maps import load_town
    try:
        load_town(town)
    except ValueError as error:
        raise StudyFileError(f"{place}: {error}") from None


def _require_free(place: str, given: Sequence[str]) -> None:
    """Refuse settings that the study gives each run itself."""
    for setting in given:
        name = setting.partition("=")[0].strip()
        if name in _FIXED:
            raise StudyFileError(
                f"{place}: {show(setting)}: the study sets {name} of each run itself, leave it out"
            )


def _require_different(path: Path, runs: Sequence[PlannedRun]) -> None:
    """Refuse a run that appears twice, and two whose names are one: of names some signs are left out."""
    seen: dict[str, PlannedRun] = {}
    for run in runs:
        other = seen.setdefault(run.name, run)
        if other is run:
            continue
        if other.row == run.row:
            raise StudyFileError(
                f"{path}: {_in_words(run)} appears twice as {run.name}, it should appear once"
            )
        raise StudyFileError(
            f"{path}: {_in_words(other)} and {_in_words(run)} would both be named {run.name}: a name has a "
            "map's file name alone, and - for other signs than a-z, 0-9, _; rename a map or a variant"
        )


def _in_words(run: PlannedRun) -> str:
    variant = f", variant {run.row.variant}" if run.row.variant else ""
    return f"{run.row.planner} in {run.row.town} with seed {run.seed}{variant}"


def require_search(path: Path, study: StudyFile) -> list[PlannedRun]:
    """Check the table of a search: that there is one, and that each range is of a setting of every run.

    Returns:
        The runs at both ends of each range of an environment's setting, which may have too little room.

    Raises:
        StudyFileError: it is missing, or a range is not valid; names the setting.
    """
    if study.search is None:
        raise StudyFileError(f"{path}: [search] is missing, which --optimise needs")
    found: list[PlannedRun] = []
    for name, wanted in study.search.ranges.items():
        ends = wanted if isinstance(wanted, list) else [wanted.low, wanted.high]
        for value in ends:
            setting = f"{name}={to_toml_value(value)}"
            _require_free(f"{path}: search.ranges", [setting])
            changed = [grid.model_copy(update={"settings": [*grid.settings, setting]}) for grid in study.grid]
            try:
                runs = planned_runs(path, study.model_copy(update={"grid": changed}))
            except CommandError as error:
                said = str(error).removeprefix(f"{path}: ").partition(": ")[2]
                raise StudyFileError(f"{path}: search.ranges: {said}") from None
            found += runs if name.startswith("environment.") else []
    return found
