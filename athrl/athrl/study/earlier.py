"""The results of a study that was begun on another machine: its `study.json`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from athrl_spaces.untrusted import one_line, parser_errors
from pydantic import BaseModel, Field, FiniteFloat, ValidationError

from athrl.errors import CommandError
from athrl.study.file import StudyFile
from athrl.study.folder import StudyFolder, read_object
from athrl.study.grid import driver_name, name_elsewhere
from athrl.study.identity import identity, joined
from athrl.study.plan import PlannedRun
from athrl.study.rows import failed

_Curve = Annotated[list[tuple[int, FiniteFloat]], Field(max_length=1000)]


class _Result(BaseModel):
    """What the tables and the picture need of a result."""

    scores: dict[str, FiniteFloat]


class _RunResult(_Result):
    decisions: int
    seconds: FiniteFloat | None
    training: dict[str, FiniteFloat]
    curves: dict[str, _Curve]


def read_earlier(path: Path, study: StudyFile, runs: Sequence[PlannedRun]) -> dict[str, Mapping[str, Any]]:
    """Return the results in another folder's `study.json`, without failures, by the names of `StudyFolder`.

    Raises:
        CommandError: the file cannot be read, is damaged or is of another study.
    """
    holder = f"--from {path}"
    with parser_errors(lambda reason: CommandError(f"{holder}: {reason}")):
        document = read_object(path)
        joined(holder, document["begun"], identity(study, runs))
        results = dict(_results(document))
    for name, result in results.items():
        _require_whole(holder, name, result)
    return results


def take_over(
    results: Mapping[str, Mapping[str, Any]],
    folder: StudyFolder,
    study: StudyFile,
    runs: Sequence[PlannedRun],
) -> int:
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


def _results(document: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield each result that is no failure, under the name by which a folder keeps it."""
    for each in document["runs"]:
        if not failed(each):
            yield each["run"], each
    for each in document["drivers"]:
        if not failed(each):
            yield driver_name(each["driver"], each["town"]), each
    for place in document["elsewhere"]:
        for each in (*place["runs"], *place["drivers"]):
            if not failed(each):
                who = each["run"] if "run" in each else f"driver-{each['driver']}"
                yield name_elsewhere(who, place["name"]), each


def _driver_names(study: StudyFile, runs: Sequence[PlannedRun]) -> Iterator[str]:
    """Yield under which names the scores of the study's reference drivers are kept."""
    for driver in study.study.drivers:
        yield from dict.fromkeys(driver_name(driver, run.row.town) for run in runs)
        yield from (name_elsewhere(f"driver-{driver}", section.name) for section in study.elsewhere)


def _require_whole(holder: str, name: str, result: Mapping[str, Any]) -> None:
    """Raise CommandError if a result lacks what a table or the picture needs."""
    try:
        (_RunResult if "seed" in result else _Result).model_validate(result)
    except ValidationError as error:
        first = error.errors()[0]
        place = ", ".join(map(str, (name, *first["loc"])))
        raise CommandError(one_line(f"{holder}: {place}: {first['msg']}")) from None
