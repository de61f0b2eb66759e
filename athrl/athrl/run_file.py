"""`athrl run-file`: the settings of a run, documented."""

from __future__ import annotations

import contextlib
from typing import Annotated

import typer
from athrl_protocol.run_file import read_run_file, to_toml
from athrl_protocol.run_file.planner_tables import kind_error

from athrl import runs
from athrl.errors import CommandError


def run_file(
    planner: Annotated[
        str | None, typer.Option(metavar="KIND", help="Kind of planner; by default that of the default run.")
    ] = None,
) -> None:
    """Print the default run file: every setting with its default, meaning and bounds."""
    with contextlib.suppress(CommandError):  # without the planners their settings are not known
        runs.declare_installed_planners()
    if planner is None:
        print(to_toml(read_run_file(None)), end="")
        return
    wrong = kind_error(planner)
    if wrong is not None:
        raise CommandError(f"--planner {planner}: {wrong}")
    print(to_toml(read_run_file(None, [f"planner.kind={planner}"])), end="")
