"""`athrl evaluate`: scores of a policy or a reference driver, in a town or the paper's case studies."""

from __future__ import annotations

import difflib
import errno
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from athrl_protocol.run_file import EnvironmentSection, RunFile
from athrl_spaces import CASE_STUDIES, REFERENCE_DRIVERS
from athrl_spaces.wording import system_reason
from rich.console import Console
from rich.table import Table

from athrl import runs
from athrl.errors import CommandError, needs
from athrl.options import ForceOption, JsonOption, RunFileOption, SetOption, given_folder, overrides

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
        str | None, typer.Option(help="Town or map to drive in; by default the run file's towns.")
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
    force: ForceOption = None,
    as_json: JsonOption = False,
    run_file: RunFileOption = None,
    settings: SetOption = None,
) -> None:
    """Drive episodes without exploration and print the scores with a 95 % interval of the return."""
    named = {setting.partition("=")[0].strip() for setting in settings or []}
    given = {"environment.towns": town, "evaluator.final_episodes": episodes, "evaluator.seed": seed}
    _check_case_study(case_study, town, named)
    by_option = [f"{name}={value}" for name, value in given.items() if value is not None]
    if town is not None:
        check_town(town)
    run_settings = runs.new_settings(run_file, overrides(settings) + by_option, training=False)
    _check_used(named, {name for name, value in given.items() if value is not None})
    _check_folder(record)
    driver = find_driver(policy)
    places = _places(run_settings.environment, case_study, named)
    results = [
        _evaluate(driver, run_settings, place, record, force or [], many=len(places) > 1) for place in places
    ]
    _print(policy, results, as_json)


def _check_case_study(case_study: str | None, town: str | None, named: set[str]) -> None:
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


def _evaluate(
    driver: str | Path,
    settings: RunFile,
    place: _Place,
    record: Path | None,
    forced: Sequence[str],
    *,
    many: bool,
) -> dict[str, Any]:
    """Score a driver; of several places each has its own folder of recordings."""
    with needs("evaluator"):
        from athrl_evaluator import EvaluationSettings, evaluate_driver
    evaluation = EvaluationSettings(
        episodes=settings.evaluator.final_episodes,
        seed=settings.evaluator.seed,
        environment=place.section,
        case_study=place.case_study,
        forced=forced,
        stall_seconds=settings.actor.stall_seconds,
    )
    folder = record / place.folder if record is not None and many else record
    scores = evaluate_driver(driver, evaluation, record=folder)
    return {**place.facts, "seed": settings.evaluator.seed, **scores.as_dict()}


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
    for name in results[0]:
        values = [result[name] for result in results]
        table.add_row(name, *(f"{value:.4g}" if isinstance(value, float) else str(value) for value in values))
    Console().print(table)
