"""`athrl evaluate`: scores of a policy or a reference driver, in a town or the paper's case studies."""

from __future__ import annotations

import difflib
import errno
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer
from athrl_protocol.run_file import EnvironmentSection, RunFile, require_same_maps
from athrl_protocol.run_file.toml_values import to_toml_value
from athrl_protocol.run_file.towns import read_towns
from athrl_spaces import CASE_STUDIES, REFERENCE_DRIVERS
from athrl_spaces.wording import system_reason
from rich.table import Table

from athrl import runs
from athrl.errors import CommandError, needs, say
from athrl.options import (
    ForceOption,
    JsonOption,
    OverwriteOption,
    RunFileOption,
    SetOption,
    given_folder,
    overrides,
)
from athrl.output import console
from athrl.train.plan import require_world

if TYPE_CHECKING:
    from athrl_evaluator import EvaluationSettings

ALL = "all"

_OPTION_OF_SETTING = {
    "environment.towns": "--town",
    "evaluator.final_episodes": "--episodes",
    "evaluator.seed": "--seed",
}
"""Settings with their own option."""

_USED = "environment.*, evaluator.final_episodes, evaluator.seed and actor.stall_seconds"


def evaluate(
    policy: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE|random|blind|rule-based",
            help="The driver; `athrl policies` lists the names of shipped policies.",
        ),
    ],
    town: Annotated[
        list[str] | None,
        typer.Option(help="Town or map to drive in; by default the run file's towns; can be repeated."),
    ] = None,
    case_study: Annotated[
        str | None,
        typer.Option(
            metavar="|".join((*CASE_STUDIES, ALL)),
            help="One of the paper's case studies, or all of them.",
        ),
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(min=2, help="Number of episodes; by default evaluator.final_episodes.")
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed of the first episode; by default evaluator.seed."),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", parser=given_folder, help="Folder for an MCAP recording of each episode."
        ),
    ] = None,
    overwrite: OverwriteOption = False,
    force: ForceOption = None,
    as_json: JsonOption = False,
    run_file: RunFileOption = None,
    settings: SetOption = None,
) -> None:
    """Drive episodes without exploration and print the scores with a 95 % interval of the return.

    A policy in the folder of a run drives by default with that run's settings, in its towns.
    """
    named = {setting.partition("=")[0].strip() for setting in settings or []}
    by_option = _by_option(town or None, episodes, seed)
    _check_case_study(case_study, town or None, named)
    _check_towns(town or [])
    _check_used(named, set(by_option))
    driver = find_driver(policy)
    own = run_file_of(driver) if run_file is None else None
    given = overrides(settings) + [f"{name}={to_toml_value(value)}" for name, value in by_option.items()]
    run_settings = runs.new_settings(run_file or own, given, training=False)
    environment = run_settings.environment if own is None else _beside_policy(run_settings.environment, named)
    places = _places(environment, case_study, named)
    if case_study is None:
        require_same_maps(run_settings)
    _require_room(places)
    _check_folder(record)
    drives = [_evaluation(run_settings, place, record, force or [], len(places) > 1) for place in places]
    _check_recordings(driver, drives, overwrite)
    results = [_evaluate(driver, *drive) for drive in drives]
    named |= {setting.partition("=")[0].strip() for setting in given}
    is_named = case_study is not None or run_file is not None or "environment.towns" in named
    told = _where_by_default(run_settings.environment, own, is_named)
    if told:
        say(told)
    _print(policy, results, as_json)


def _by_option(town: list[str] | None, episodes: int | None, seed: int | None) -> dict[str, Any]:
    """Return the settings that have their own option and are given by it."""
    values = {"environment.towns": town, "evaluator.final_episodes": episodes, "evaluator.seed": seed}
    return {name: value for name, value in values.items() if value is not None}


def run_file_of(driver: str | Path) -> Path | None:
    """Return the run file of the run in whose folder a policy is; None for another driver."""
    path = driver.absolute().parent if isinstance(driver, Path) else Path()
    beside = path.parent / "run.toml"
    return beside if path.name == "policies" and beside.is_file() else None


def _where_by_default(environment: EnvironmentSection, own: Path | None, is_named: bool) -> str:
    """Return one line that says where was driven, unless the command line or a run file names it."""
    towns = ", ".join(environment.towns)
    if own is not None:
        where = "" if is_named else f" in {towns}"
        return f"driven{where} with the settings of the policy's run, {os.path.relpath(own)}"
    return "" if is_named else f"driven in {towns}, the default: --town names another town or a map"


def _check_case_study(case_study: str | None, town: list[str] | None, named: set[str]) -> None:
    """Refuse an unknown case study, and a town together with a case study."""
    if case_study is None:
        return
    if case_study not in (*CASE_STUDIES, ALL):
        choice = f"{', '.join(CASE_STUDIES)} or {ALL}"
        raise CommandError(f"--case-study {case_study}: there is no such case study, it should be {choice}")
    if town is not None or "environment.towns" in named:
        option = "--town" if town is not None else "--set environment.towns"
        raise CommandError(f"{option} cannot be used with --case-study, which has its own: leave one out")


def _check_used(named: set[str], by_option: set[str]) -> None:
    """Refuse settings of the command line without effect; run file and ATHRL_SET may have others."""
    for name in sorted(named):
        if name in by_option:
            raise CommandError(f"--set {name} and {_OPTION_OF_SETTING[name]} say the same: leave one out")
        section = name.partition(".")[0]
        if section != "environment" and name not in _OPTION_OF_SETTING and name != "actor.stall_seconds":
            raise CommandError(f"--set {name}: evaluate only drives and would ignore it; it uses {_USED}")


def _check_towns(towns: list[str]) -> None:
    """Refuse the towns of `--town` as `check_town` does, and one that is given twice."""
    for town in towns:
        check_town(town)
    try:
        if towns:
            read_towns(towns)
    except ValueError as error:
        raise CommandError(f"--town {error}") from None


def check_town(town: str, vehicles: int = 0) -> None:
    """Refuse an unknown town and a map that cannot be driven or has too little room, by the option's name.

    Raises:
        CommandError: the town is one of these.
    """
    with needs("evaluator"):
        from athrl_driving.maps import load_town
        from athrl_driving.traffic import starting_places
    try:
        places = starting_places(load_town(town))
    except ValueError as error:
        raise CommandError(f"--town {town}: {error}") from None
    if vehicles > places:
        raise CommandError(f"--vehicles {vehicles}: {town} has room for {places} at most")


def _check_folder(folder: Path | None) -> None:
    """Make the folder for recordings before anything is driven."""
    try:
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            if not os.access(folder, os.W_OK | os.X_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        cause = system_reason(error)
        raise CommandError(
            f"--record {folder}: {cause}, it should be a folder that can be made and written"
        ) from None


def _check_recordings(driver: str | Path, drives: Sequence[_Drive], overwrite: bool) -> None:
    """Refuse to replace recordings, which may be of another map, before anything is driven."""
    with needs("evaluator"):
        from athrl_evaluator.evaluate import recordings_of
    for _, settings, folder in drives if not overwrite else []:
        for path in recordings_of(driver, settings, folder) if folder is not None else []:
            if path.exists():
                raise CommandError(f"{path} exists already: name another folder, or add --overwrite")


def find_driver(policy: str, option: str = "--policy ") -> str | Path:
    """Return the name of a reference driver, or the file of a policy by its path or name.

    `option` is what an error begins with, where the driver is given by an option.

    Raises:
        CommandError: it is none of these; names the nearest.
    """
    if policy in REFERENCE_DRIVERS:
        return policy
    path = Path(policy)
    if path.is_file():
        return path
    with needs("evaluator"):
        from athrl_evaluator.policies.shipped import shipped_names, shipped_policy
    if policy in shipped_names():
        return shipped_policy(policy)
    wrong = "there is no such file"
    if policy and path.exists():
        wrong = "is a folder" if path.is_dir() else "is a pipe, socket or device"
    names = [*REFERENCE_DRIVERS, *shipped_names()]
    near = difflib.get_close_matches(policy, names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]}?" if near else ""
    raise CommandError(f"{option}{policy}: {wrong}, and it is none of {', '.join(names)}{hint}")


@dataclass(frozen=True)
class _Place:
    """A place where episodes are driven.

    Attributes:
        section: settings of the environments.
        case_study: the case study, if it is one.
        facts: fields of the results that describe the place.
        folder: subfolder of its recordings, if there are several places.
    """

    section: EnvironmentSection
    case_study: str | None
    facts: dict[str, str]
    folder: str


def _places(section: EnvironmentSection, case_study: str | None, named: set[str]) -> list[_Place]:
    """Return one place for each case study, or else for each town."""
    if case_study is not None:
        beside = _beside_case_study(section, named)
        studies = list(CASE_STUDIES) if case_study == ALL else (case_study,)
        return [_Place(beside, study, {"case_study": study}, study) for study in studies]
    with needs("evaluator"):
        from athrl_evaluator.scoring.environments import in_town, town_labels
    labels = town_labels(list(section.towns))
    return [_Place(in_town(section, town), None, {"town": town}, label) for town, label in labels.items()]


def _require_room(places: Sequence[_Place]) -> None:
    """Refuse more vehicles than a place has room for; a case study has fewer, unless they are given."""
    with needs("evaluator"):
        from athrl_evaluator.scoring.case_studies import case_study_settings
        from athrl_evaluator.scoring.environments import in_town
    for place in places:
        if place.case_study is None:
            require_world(place.section)
        elif "vehicles" in place.section.model_fields_set:
            require_world(in_town(place.section, case_study_settings(place.case_study)["town"]))


class _Drive(NamedTuple):
    """What is driven in a place, and the folder for its recordings."""

    facts: dict[str, str]
    settings: EvaluationSettings
    folder: Path | None


def _evaluation(
    settings: RunFile, place: _Place, record: Path | None, forced: Sequence[str], many: bool
) -> _Drive:
    """Return what is driven in a place; of several places each has its own folder of recordings."""
    with needs("evaluator"):
        from athrl_evaluator import EvaluationSettings
    evaluation = EvaluationSettings(
        episodes=settings.evaluator.final_episodes,
        seed=settings.evaluator.seed,
        environment=place.section,
        case_study=place.case_study,
        forced=forced,
        stall_seconds=settings.actor.stall_seconds,
    )
    return _Drive(place.facts, evaluation, record / place.folder if record is not None and many else record)


def _evaluate(
    driver: str | Path, facts: dict[str, str], settings: EvaluationSettings, folder: Path | None
) -> dict[str, Any]:
    with needs("evaluator"):
        from athrl_evaluator import evaluate_driver
    scores = evaluate_driver(driver, settings, record=folder)
    return {**facts, "seed": settings.seed, **scores.as_dict()}


def _beside_policy(section: EnvironmentSection, named: set[str]) -> EnvironmentSection:
    """Settings of a policy's own run: of what follows from the policy itself only what is given is kept."""
    with needs("evaluator"):
        from athrl_evaluator.scoring.environments import FIXED_BY_POLICY
    own = FIXED_BY_POLICY - {name.removeprefix("environment.") for name in named}
    return EnvironmentSection(**section.model_dump(include=section.model_fields_set - own))


def _beside_case_study(section: EnvironmentSection, named: set[str]) -> EnvironmentSection:
    """Settings for a case study: of those that it fixes itself only the command line's are kept."""
    own = {"towns", "vehicles", "episode_ticks"} - {name.removeprefix("environment.") for name in named}
    return EnvironmentSection(**section.model_dump(include=section.model_fields_set - own))


def _print(policy: str, results: Sequence[dict[str, Any]], as_json: bool) -> None:
    """Print one JSON object, with several results in `case_studies` or `towns`, or a table."""
    many = "towns" if "town" in results[0] else "case_studies"
    if as_json:
        facts = results[0] if len(results) == 1 else {many: results}
        print(json.dumps({"policy": policy, **facts}))
        return
    where = f" in {results[0]['town']}" if many == "towns" and len(results) == 1 else ""
    table = Table(title=f"{policy}{where}", show_header=False)
    table.add_column(no_wrap=True)
    for _ in results:
        table.add_column(overflow="fold")  # a map's path has to stay whole
    for name in results[0]:
        values = [result[name] for result in results]
        table.add_row(name, *(f"{value:.4g}" if isinstance(value, float) else str(value) for value in values))
    console().print(table)
