"""The command `athrl`: its subcommands, and one line on standard error for everything that is no bug."""

from __future__ import annotations

import logging
import sys
import traceback
from importlib.metadata import version
from typing import Annotated, Any

import typer

from athrl import certificates, evaluate, router, run_file, services, status, watch
from athrl.doctor import command as doctor
from athrl.errors import EXPECTED_ERROR, expected_errors, say
from athrl.stopping import leave
from athrl.train import command as train

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


app.command("train")(train.train)
app.command("learner")(services.learner)
app.command("actor")(services.actor)
app.command("evaluator")(services.evaluator)
app.command("router")(router.router)
app.command("evaluate")(evaluate.evaluate)
app.command("watch")(watch.watch)
app.command("status")(status.status)
app.command("doctor")(doctor.doctor)
app.command("certificates")(certificates.certificates)
app.command("run-file")(run_file.run_file)


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
    try:
        return app(prog_name="athrl", standalone_mode=False) or 0
    except UsageError as error:  # an option that is missing, unknown or out of its bounds
        if not error.format_message():  # without a subcommand the help has been shown
            return EXPECTED_ERROR
        say(f"{str(error.format_message()).rstrip('.')}; see athrl {_subcommand()}--help")
        return EXPECTED_ERROR
    except typer.Abort:
        return 130
    except expected_errors() as error:
        say(error)
        return EXPECTED_ERROR


def _subcommand() -> str:
    names = {command.name for command in app.registered_commands}
    return next((f"{word} " for word in sys.argv[1:2] if word in names), "")
