"""`athrl evaluate`: scores of a policy file or of a reference driver."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from athrl_protocol.run_file import RunFile
from rich.console import Console
from rich.table import Table

from athrl import runs
from athrl.errors import CommandError, needs
from athrl.options import DEFAULTS, JsonOption, RunFileOption, SetOption, overrides

REFERENCE_DRIVERS = ("random", "blind", "rule-based")


def evaluate(
    policy: Annotated[str, typer.Option(metavar="FILE|random|blind|rule-based", help="Who drives.")],
    town: Annotated[str | None, typer.Option(help="The town to drive in; by default the run file's.")] = None,
    episodes: Annotated[
        int, typer.Option(min=2, help="Episodes to drive.")
    ] = DEFAULTS.evaluator.final_episodes,
    seed: Annotated[
        int, typer.Option(min=0, help="The first episode's seed; the others have the ones after it.")
    ] = DEFAULTS.evaluator.seed,
    as_json: JsonOption = False,
    run_file: RunFileOption = None,
    settings: SetOption = None,
) -> None:
    """Drive episodes without exploration and print the scores with a 95 % interval of the return."""
    given = overrides(settings)
    if town is not None:
        _check_town(town)
        given.append(f"environment.town={town}")
    run_settings = runs.new_settings(run_file, given)
    scores = _evaluate(policy, run_settings, episodes, seed)
    facts = {"policy": policy, "town": run_settings.environment.town, "seed": seed, **scores}
    if as_json:
        print(json.dumps(facts))
        return
    table = Table(title=f"{policy} in {run_settings.environment.town}", show_header=False)
    for name, value in facts.items():
        table.add_row(name, f"{value:.4g}" if isinstance(value, float) else str(value))
    Console().print(table)


def _check_town(town: str) -> None:
    """Refuse a town that there is not by the option's name, and a map that cannot be driven."""
    with needs("evaluator"):
        from athrl_driving.maps import load_town
    try:
        load_town(town)
    except ValueError as error:
        raise CommandError(f"--town {town}: {error}") from None


def _evaluate(policy: str, settings: RunFile, episodes: int, seed: int) -> dict[str, float]:
    """Score a driver by its name or a policy by its file's name."""
    with needs("evaluator"):
        from athrl_evaluator import evaluate_driver
    driver: str | Path = policy
    if policy not in REFERENCE_DRIVERS:
        driver = Path(policy)
        if not driver.is_file():
            choice = ", ".join(REFERENCE_DRIVERS)
            wrong = "is a folder" if driver.is_dir() else "there is no such file"
            raise CommandError(f"--policy {policy}: {wrong}, and it is none of {choice}")
    scores = evaluate_driver(driver, environment=settings.environment, episodes=episodes, seed=seed)
    return scores.as_dict()
