"""The command `athrl`: its subcommands, and one line on standard error for everything that is no bug."""

from __future__ import annotations

import logging
import sys
import traceback
from collections.abc import Iterable
from importlib import import_module
from importlib.metadata import version
from typing import Annotated, Any

import typer

from athrl.errors import EXPECTED_ERROR, expected_errors, say
from athrl.stopping import leave

SUBCOMMANDS = {
    "train": "athrl.train.command:train",
    "learner": "athrl.services:learner",
    "actor": "athrl.services:actor",
    "evaluator": "athrl.services:evaluator",
    "router": "athrl.router:router",
    "evaluate": "athrl.evaluate:evaluate",
    "policies": "athrl.policies:policies",
    "watch": "athrl.watch:watch",
    "status": "athrl.status:status",
    "doctor": "athrl.doctor.command:doctor",
    "certificates": "athrl.certificates:certificates",
    "run-file": "athrl.run_file:run_file",
}
"""Where each is. Only the one that is wanted is loaded: a killed service is back so much sooner."""

UsageError: Any = typer.BadParameter.__base__
"""Whatever is wrong with the words of a command line; typer has no public name for it."""


def _tell_version(wanted: bool) -> None:
    if wanted:
        print(f"athrl {version('athrl')}")
        raise typer.Exit


app = typer.Typer(
    name="athrl",
    help="Train a hierarchical driving planner with many actors, one learner and an evaluator.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def _whole(
    version: Annotated[
        bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None: ...


def _load(names: Iterable[str]) -> None:
    for name in names:
        module, _, function = SUBCOMMANDS[name].partition(":")
        app.command(name)(getattr(import_module(module), function))


def main() -> None:
    """Run the command; an expected error ends it with one line and exit code 2."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(message)s", stream=sys.stderr)
    try:
        code = _run()
    except Exception:  # a bug
        traceback.print_exc()
        code = 1
    leave(code)


def _run() -> int:
    """Run the command; return its exit code."""
    wanted = _subcommand()
    try:
        _load([wanted] if wanted else SUBCOMMANDS)
        return app(prog_name="athrl", standalone_mode=False) or 0
    except UsageError as error:  # an option that is missing, unknown or out of its bounds
        if not error.format_message():  # without a subcommand the help has been shown
            return EXPECTED_ERROR
        say(f"{str(error.format_message()).rstrip('.')}; see athrl {f'{wanted} ' if wanted else ''}--help")
        return EXPECTED_ERROR
    except (typer.Abort, KeyboardInterrupt):
        return 130
    except expected_errors() as error:
        say(error)
        return EXPECTED_ERROR


def _subcommand() -> str:
    """Return the subcommand of the command line, or nothing if there is none, or none of that name."""
    return next((word for word in sys.argv[1:2] if word in SUBCOMMANDS), "")
