"""`athrl evaluate`: scores of a policy or a reference driver, in a town or the paper's case studies."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from athrl_protocol.run_file import require_same_maps
from athrl_protocol.run_file.toml_values import to_toml_value
from athrl_spaces import CASE_STUDIES

from athrl import runs
from athrl.errors import CommandError, say
from athrl.evaluate.drivers import find_driver, run_file_of
from athrl.evaluate.driving import check_recordings, drive_in, make_folder, scored
from athrl.evaluate.output import print_scores, where_by_default
from athrl.evaluate.places import ALL_CASE_STUDIES, beside_policy, check_towns, places_of, require_room
from athrl.options import (
    ForceOption,
    JsonOption,
    OverwriteOption,
    RunFileOption,
    SetOption,
    given_folder,
    overrides,
)

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
            metavar="|".join((*CASE_STUDIES, ALL_CASE_STUDIES)),
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
    check_towns(town or [])
    _check_used(named, set(by_option))
    driver = find_driver(policy)
    own = run_file_of(driver) if run_file is None else None
    given = overrides(settings) + [f"{name}={to_toml_value(value)}" for name, value in by_option.items()]
    run_settings = runs.new_settings(run_file or own, given, training=False)
    environment = run_settings.environment if own is None else beside_policy(run_settings.environment, named)
    places = places_of(environment, case_study, named)
    if case_study is None:
        require_same_maps(run_settings)
    require_room(places)
    make_folder(record)
    drives = [drive_in(run_settings, place, record, force or [], len(places) > 1) for place in places]
    check_recordings(driver, drives, overwrite)
    results = [scored(driver, *drive) for drive in drives]
    named |= {setting.partition("=")[0].strip() for setting in given}
    is_named = case_study is not None or run_file is not None or "environment.towns" in named
    told = where_by_default(run_settings.environment, own, is_named)
    if told:
        say(told)
    print_scores(policy, results, as_json)


def _by_option(town: list[str] | None, episodes: int | None, seed: int | None) -> dict[str, Any]:
    """Return the settings that have their own option and are given by it."""
    values = {"environment.towns": town, "evaluator.final_episodes": episodes, "evaluator.seed": seed}
    return {name: value for name, value in values.items() if value is not None}


def _check_case_study(case_study: str | None, town: list[str] | None, named: set[str]) -> None:
    """Refuse an unknown case study, and a town together with a case study."""
    if case_study is None:
        return
    if case_study not in (*CASE_STUDIES, ALL_CASE_STUDIES):
        choice = f"{', '.join(CASE_STUDIES)} or {ALL_CASE_STUDIES}"
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
