"""The command `athrl`: its subcommands, and one line on standard error for every expected error."""

from __future__ import annotations

import errno
import sys
import traceback
from collections.abc import Iterable
from importlib import import_module
from importlib.metadata import version
from typing import Annotated, Any, NamedTuple

import typer
from athrl_spaces.wording import system_reason

from athrl.errors import EXPECTED_ERROR, expected_errors, say
from athrl.output import accept_any_text, discard_output, flush_output, start_log
from athrl.stopping import leave
from athrl.usage import UsageError, explain


class Subcommand(NamedTuple):
    """Where a subcommand is, and its line in `athrl --help`."""

    function: str
    """Module and function, or an app with subcommands of its own.

    Only the requested one is loaded, so that services restart faster.
    """
    summary: str
    panel: str


_RUNS, _SERVICES = "Runs and policies", "Services and machines"

SUBCOMMANDS = {
    "train": Subcommand("athrl.train.command:train", "Train on this machine.", _RUNS),
    "study": Subcommand("athrl.study.command:study", "Train a grid of runs; a table and curves.", _RUNS),
    "submit": Subcommand("athrl.submit.command:submit", "Train as jobs of Slurm.", _RUNS),
    "evaluate": Subcommand("athrl.evaluate.command:evaluate", "Score a policy or a reference driver.", _RUNS),
    "watch": Subcommand("athrl.watch:watch", "Show an episode in rerun.", _RUNS),
    "replay": Subcommand("athrl.replay:replay", "Drive a recorded episode again and compare.", _RUNS),
    "record": Subcommand("athrl.record:record", "Film a policy or a reference driver.", _RUNS),
    "status": Subcommand("athrl.status:status", "Show the state of a live run.", _RUNS),
    "policies": Subcommand("athrl.policies:policies", "List the policies of this package.", _RUNS),
    "maps": Subcommand("athrl.maps.command:maps", "List the towns; check a map of your own.", _RUNS),
    "run-file": Subcommand("athrl.run_file:run_file", "Print every setting with its meaning.", _RUNS),
    "learner": Subcommand(
        "athrl.services:learner", "Receive experience, train, publish policies.", _SERVICES
    ),
    "actor": Subcommand("athrl.services:actor", "Drive with the newest policy and stream.", _SERVICES),
    "evaluator": Subcommand("athrl.services:evaluator", "Score and record policies.", _SERVICES),
    "router": Subcommand("athrl.router:router", "Connect many services to one learner.", _SERVICES),
    "certificates": Subcommand("athrl.certificates:certificates", "Make certificates for a run.", _SERVICES),
    "doctor": Subcommand("athrl.doctor.command:doctor", "Check this installation and machine.", _SERVICES),
}

_OF_PATHS = (errno.EACCES, errno.ELOOP, errno.ENAMETOOLONG, errno.EPERM)
"""Errors of a path, which the user can correct."""

_OF_DISKS = (errno.EDQUOT, errno.EFBIG, errno.ENOSPC)
"""Errors of a write, above all of an output that goes into a file."""


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"athrl {version('athrl')}")
        raise typer.Exit


app = typer.Typer(
    name="athrl",
    help="Train driving planners with many actors and one learner.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None: ...


def _load(names: Iterable[str]) -> None:
    for name in names:
        subcommand = SUBCOMMANDS[name]
        module, _, function = subcommand.function.partition(":")
        found, (_, summary, panel) = getattr(import_module(module), function), subcommand
        if isinstance(found, typer.Typer):
            app.add_typer(found, name=name, short_help=summary, rich_help_panel=panel)
        else:
            app.command(name, short_help=summary, rich_help_panel=panel)(found)


def main() -> None:
    """Run the command; an expected error ends it with one line and exit code 2."""
    accept_any_text()
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
        start_log()
        _load([wanted] if wanted else SUBCOMMANDS)
        code = _command()(prog_name="athrl", standalone_mode=False) or 0
        flush_output()
        return code
    except UsageError as error:  # an option that is missing, unknown or out of bounds
        wrong = explain(error)
        if wrong:  # without a subcommand the help has been shown
            say(f"{wrong}; see {error.ctx.command_path if error.ctx else 'athrl'} --help")
        return EXPECTED_ERROR
    except (typer.Abort, KeyboardInterrupt):
        return 130
    except expected_errors() as error:
        say(error)
        return EXPECTED_ERROR
    except OSError as error:
        reason = system_reason(error)
        if error.errno in _OF_PATHS:  # of a path in the command line that is only looked up
            say(f"{error.filename}: {reason}")
        elif error.errno in _OF_DISKS:
            discard_output()
            say(f"{error.filename or 'standard output'} cannot be written: {reason}; make room and try again")
        else:
            raise
        return EXPECTED_ERROR


def _command() -> Any:
    """Return the command; options that install tab completion work and take no room in the help."""
    command = typer.main.get_command(app)
    for parameter in command.params:
        if parameter.name in ("install_completion", "show_completion"):
            parameter.hidden = True  # type: ignore[attr-defined]
    return command


def _subcommand() -> str:
    """Return the subcommand of the command line; empty if there is none of that name."""
    return next((word for word in sys.argv[1:2] if word in SUBCOMMANDS), "")
