"""Options that several subcommands share."""

from __future__ import annotations

import os
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated

import typer
from athrl_protocol.certificates import VARIABLE
from athrl_protocol.refusal_log import refusals_logged
from athrl_protocol.run_file import RunFile

DEFAULTS = RunFile()

RunFileOption = Annotated[
    Path | None,
    typer.Option(
        "--run-file",
        envvar="ATHRL_RUN_FILE",
        help="TOML file with the run's settings; `athrl run-file` prints one.",
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a setting, such as learner.batch=64; ATHRL_SET holds more of them.",
    ),
]
ConnectOption = Annotated[
    str,
    typer.Option(
        "--connect",
        envvar="ATHRL_CONNECT",
        metavar="ADDRESS",
        help="The learner's address, or a router's.",
    ),
]
NameOption = Annotated[
    str | None,
    typer.Option(
        "--name", help="The service's name, one of its own; by default this machine's and process's."
    ),
]
CertificatesOption = Annotated[
    Path | None,
    typer.Option(
        "--certificates",
        envvar=VARIABLE,
        metavar="FOLDER",
        callback=lambda folder: use_certificates(folder),
        help="Folder that `athrl certificates` made, or the one of a single role in it.",
    ),
]
RunOption = Annotated[str, typer.Option("--run", envvar="ATHRL_RUN", metavar="RUN", help="The run's name.")]
LiveRunOption = Annotated[
    str | None,
    typer.Option(
        "--run", envvar="ATHRL_RUN", metavar="RUN", help="The run's name; not needed where there is but one."
    ),
]
ForceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--force",
        metavar="NAME=VALUE",
        help="Have the policy decide this all the time, such as intention=0; several.",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def use_certificates(folder: str | Path | None) -> Path | None:
    """Tell every session of this process and of those it starts which folder to use, if any is given."""
    if folder:
        os.environ[VARIABLE] = str(folder)
    return Path(folder) if folder else None


def refusals_told(secure: bool) -> AbstractContextManager[None]:
    """Have the log of a process that listens say who was refused what; without certificates nobody is."""
    return refusals_logged() if secure else nullcontext()


def overrides(given: list[str] | None) -> list[str]:
    """Return ATHRL_SET's settings, separated by white space, and after them those of the command line."""
    return os.environ.get("ATHRL_SET", "").split() + list(given or [])
