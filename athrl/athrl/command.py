"""The command `athrl`: its subcommands, and one line on standard error for everything that is no bug."""

from __future__ import annotations

import logging
import sys

import typer

from athrl import evaluate, run_file, services, status, watch
from athrl.errors import EXPECTED_ERROR, expected_errors, say
from athrl.train import command as train

app = typer.Typer(
    name="athrl",
    help="Train a hierarchical driving planner with many actors, one learner and an evaluator.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("train")(train.train)
app.command("learner")(services.learner)
app.command("actor")(services.actor)
app.command("evaluator")(services.evaluator)
app.command("evaluate")(evaluate.evaluate)
app.command("watch")(watch.watch)
app.command("status")(status.status)
app.command("run-file")(run_file.run_file)


def main() -> None:
    """Run the command; an expected error ends it with one line and exit code 2."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(message)s", stream=sys.stderr)
    try:
        app(prog_name="athrl")
    except expected_errors() as error:
        say(error)
        sys.exit(EXPECTED_ERROR)
