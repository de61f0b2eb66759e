"""The results of a study that was begun on another machine: its `study.json`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from athrl_spaces.untrusted import one_line, parser_errors
from pydantic import BaseModel, Field, ValidationError

from athrl.errors import CommandError
from athrl.study.file import SCORES, StudyFile
from athrl.study.folder import StudyFolder, read_object
from athrl.study.grid import driver_name, name_elsewhere
from athrl.study.identity import identity, joined
from athrl.study.plan import PlannedRun
from athrl.study.rows import failed

_OPTIONAL = frozenset({"success_seconds"})
_Number = Annotated[float, Field(ge=-1e12, le=1e12)]
_Count = Annotated[int, Field(ge=0, le=10**12)]
_Text = Annotated[str, Field(max_length=1000)]
_Curve = Annotated[list[tuple[_Count, _Number]], Field(max_length=1000)]


class _Scored(BaseModel):
    """Scores, with all that the tables need."""

    scores: dict[str, _Number]

    def model_post_init(self, _: Any) -> None:
        """Raise ValueError if a score is missing, and leave out what is none."""
        missing = [name for name in SCORES if name not in self.scores and name not in _OPTIONAL]
        if missing:
            raise ValueError(f"has no score {missing[0]}")
        self.scores = {name: value for name, value in self.scores.items() if name in SCORES}


class _Curves(BaseModel):
    training: _Curve
    greedy: _Curve


class _Made(BaseModel):
    version: _Text
    commit: _Text
    date: _Text
    cores: _Count
    processor: _Text


class _RunResult(_Scored):
    run: _Text
    planner: _Text
    town: _Text
    variant: _Text
    seed: _Count
    decisions: _Count
    seconds: _Number | None
    training: dict[_Text, _Number]
    curves: _Curves
    made: _Made


class _RunElsewhere(_Scored):
    run: _Text
    place: _Text


class _DriverAtHome(_Scored):
    driver: _Text
    town: _Text


class _DriverElsewhere(_Scored):
    driver: _Text
    place: _Text


Results = dict[str, dict[str, Any]]
"""Results by the names of `StudyFolder`."""


def read_earlier(path: Path, study: StudyFile, runs: Sequence[PlannedRun]) -> Results:
    """Return the results in another folder's `study.json`, without failures and what the study has not.

    Raises:
        CommandError: the file cannot be read, is damaged or is of another study.
    """
    holder = f"--from {path}"
    planned = {run.name: run for run in runs}
    results: Results = {}
    with parser_errors(lambda reason: CommandError(f"{holder}: {reason}")):
        document = read_object(path)
        joined(holder, document["begun"], identity(study, runs))
        for each in _finished(document["runs"]):
            run = planned.get(each["run"])
            if run is not None:
                results[run.name] = _checked(holder, run.name, each, _RunResult)
                _require_same_run(holder, run, results[run.name])
        for each in _finished(document["drivers"]):
            name = driver_name(each["driver"], each["town"])
            results[name] = _checked(holder, name, each, _DriverAtHome)
        for place in document["elsewhere"]:
            results |= _elsewhere(holder, place)
    return results


def take_over(results: Results, folder: StudyFolder, study: StudyFile, runs: Sequence[PlannedRun]) -> int:
    """Note what the folder lacks of the results of `read_earlier`; return how many runs that were.

    A run counts only if it was also scored in every place of the study: its policy is not here.
    """
    places = [section.name for section in study.elsewhere]
    taken = 0
    for run in runs:
        names = [run.name, *(name_elsewhere(run.name, place) for place in places)]
        if folder.result(run.name) is None and all(name in results for name in names):
            taken += 1
            for name in names:
                folder.note(name, results[name])
    for name in _driver_names(study, runs):
        if folder.result(name) is None and name in results:
            folder.note(name, results[name])
    return taken


def _finished(results: Iterable[Mapping[str, Any]]) -> Iterator[Mapping[str, Any]]:
    return (each for each in results if not failed(each))


def _elsewhere(holder: str, place: Mapping[str, Any]) -> Results:
    """Return the results in one place, of runs and of drivers."""
    found: Results = {}
    for each in _finished(place["runs"]):
        name = name_elsewhere(each["run"], place["name"])
        found[name] = _checked(holder, name, each, _RunElsewhere)
    for each in _finished(place["drivers"]):
        name = name_elsewhere(f"driver-{each['driver']}", place["name"])
        found[name] = _checked(holder, name, each, _DriverElsewhere)
    return found


def _driver_names(study: StudyFile, runs: Sequence[PlannedRun]) -> Iterator[str]:
    """Yield under which names the scores of the study's reference drivers are kept."""
    for driver in study.study.drivers:
        yield from dict.fromkeys(driver_name(driver, run.row.town) for run in runs)
        yield from (name_elsewhere(f"driver-{driver}", section.name) for section in study.elsewhere)


def _checked(holder: str, name: str, result: Mapping[str, Any], model: type[_Scored]) -> dict[str, Any]:
    """Return what tables and picture need of a result; raises CommandError if it lacks some of it."""
    try:
        return model.model_validate(result).model_dump()
    except ValidationError as error:
        first = error.errors()[0]
        place = ", ".join(map(str, (name, *first["loc"])))
        raise CommandError(one_line(f"{holder}: {place}: {first['msg']}")) from None


def _require_same_run(holder: str, run: PlannedRun, result: Mapping[str, Any]) -> None:
    wanted = {
        "planner": run.row.planner,
        "town": run.row.town,
        "variant": run.row.variant,
        "seed": run.seed,
    }
    for key, value in wanted.items():
        if result[key] != value:
            raise CommandError(
                one_line(f"{holder}: {run.name}, {key}: is {result[key]!r}, should be {value!r}")
            )
