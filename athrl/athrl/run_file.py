"""`athrl run-file`: the settings of a run, documented."""

from __future__ import annotations

import contextlib
from typing import Annotated

import typer
from athrl_protocol.run_file import read_run_file, to_toml

from athrl import runs
from athrl.errors import CommandError


def run_file(
    planner: Annotated[
        str | None, typer.Option(metavar="KIND", help="The planner; by default the one of the default run.")
    ] = None,
) -> None:
    """Print the default run file: every setting with its default, its meaning and its bounds."""
    with contextlib.suppress(CommandError):  # without the planners their settings are not known
        runs.know_planners()
    print(to_toml(read_run_file(None, [] if planner is None else [f"planner.kind={planner}"])), end="")
