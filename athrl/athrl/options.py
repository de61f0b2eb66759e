"""Options that several subcommands share."""

from __future__ import annotations

import os
import re
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated

import typer
from athrl_protocol.errors import ProtocolError
from athrl_protocol.faults.zenoh_refusals import refusals_logged
from athrl_protocol.monitoring.address import metrics_address
from athrl_protocol.run_file import OverrideFrom, RunFile
from athrl_protocol.security.certificates import VARIABLE

from athrl.errors import CommandError

DEFAULTS = RunFile()

WHAT, WHERE = "What to run", "Machine and network"
"""Groups of options in the help."""

SET_VARIABLE = "ATHRL_SET"
_WORD = re.compile(r"""(?:"[^"]*"|'[^']*'|\S)+""")
"""A setting in that variable: quotes of TOML, which stay, hold what is in them together."""

METRICS_VARIABLE = "ATHRL_METRICS_LISTEN"
"""Where evaluator and router answer Prometheus, unless an option says it."""


def given_folder(text: str) -> Path:
    """The folder that was given; raises CommandError for an empty text, which would be the present folder."""
    if not text:
        raise CommandError("the folder's path is empty: name a folder, with . for the one you are in")
    return Path(text)


RunFileOption = Annotated[
    Path | None,
    typer.Option(
        "--run-file",
        envvar="ATHRL_RUN_FILE",
        help="TOML file with settings; `athrl run-file` prints the default.",
        rich_help_panel=WHAT,
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a setting, such as learner.batch=64; can be repeated; ATHRL_SET has more.",
        rich_help_panel=WHAT,
    ),
]
ConnectOption = Annotated[
    str,
    typer.Option(
        "--connect",
        envvar="ATHRL_CONNECT",
        metavar="ADDRESS",
        callback=lambda given: find_learner(given),
        help="Address of the learner or of a router, or the folder of a run that has the learner's address.",
        rich_help_panel=WHERE,
    ),
]
FollowOption = Annotated[
    str,
    typer.Option(
        "--connect",
        envvar="ATHRL_CONNECT",
        metavar="ADDRESS",
        help="Address of the learner or of a router, or the folder of a run, whose learner is followed.",
        rich_help_panel=WHERE,
    ),
]
NameOption = Annotated[
    str | None,
    typer.Option("--name", help="Unique name of the service; without it the learner gives an actor one."),
]
CertificatesOption = Annotated[
    Path | None,
    typer.Option(
        "--certificates",
        envvar=VARIABLE,
        metavar="FOLDER",
        callback=lambda folder: use_certificates(folder),
        help="Folder made by `athrl certificates`, or its subfolder of one role.",
        rich_help_panel=WHERE,
    ),
]
MetricsListenOption = Annotated[
    str,
    typer.Option(
        "--metrics-listen",
        envvar=METRICS_VARIABLE,
        metavar="ADDRESS",
        callback=lambda given: check_metrics_address(given),
        help="Answer Prometheus there: PORT (on loopback), HOST:PORT or every-address:PORT.",
        rich_help_panel=WHERE,
    ),
]
RunOption = Annotated[
    str,
    typer.Option("--run", envvar="ATHRL_RUN", metavar="RUN", help="Name of the run.", rich_help_panel=WHAT),
]
LiveRunOption = Annotated[
    str | None,
    typer.Option(
        "--run",
        envvar="ATHRL_RUN",
        metavar="RUN",
        help="Name of the run; not needed if there is only one.",
        rich_help_panel=WHAT,
    ),
]
ForceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--force",
        metavar="NAME=VALUE",
        help="Fix a decision of the policy, such as intention=0; can be repeated.",
    ),
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace a file that exists already.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print only one JSON object.")]


def find_learner(connect: str) -> str:
    """Return the address of a learner that is named by its address or by its run's folder."""
    from athrl.rendezvous.run_folder import learner_address

    return learner_address(connect)


def check_metrics_address(listen: str) -> str:
    """Return an address for metrics, or an empty text; raise `CommandError` unless it is one."""
    try:
        if listen:
            metrics_address(listen)
    except ProtocolError as error:
        raise CommandError(f"--metrics-listen: {error}") from None
    return listen


def use_certificates(folder: str | Path | None) -> Path | None:
    """Set the folder for every session of this process and its child processes, if one is given."""
    if folder:
        os.environ[VARIABLE] = str(folder)
    return Path(folder) if folder else None


def logged_refusals(secure: bool) -> AbstractContextManager[None]:
    """Log Zenoh's refusals in a listening process; without certificates there are none."""
    return refusals_logged() if secure else nullcontext()


def overrides(given: list[str] | None) -> list[str]:
    """Return the settings in ATHRL_SET, separated by spaces outside of quotes, then the command line's."""
    words = _WORD.findall(os.environ.get(SET_VARIABLE, ""))
    return [*(OverrideFrom(word, SET_VARIABLE) for word in words), *(given or [])]
