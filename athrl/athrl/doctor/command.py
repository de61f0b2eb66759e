"""`athrl doctor`: one line for each check, with what was found and what to do."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from dataclasses import asdict
from typing import Annotated

import typer
from athrl_protocol.run_file import RunFile
from athrl_spaces.wording import counted
from rich.console import Console
from rich.text import Text

from athrl import runs
from athrl.doctor import disk, installation, live_run, machine, network, round_trip
from athrl.doctor.finding import Check, Finding, Level, findings_of
from athrl.errors import CommandError
from athrl.options import CertificatesOption, JsonOption, LiveRunOption, RunFileOption, SetOption, overrides
from athrl.rendezvous.run_folder import folder_in, learner_address

FAILED = 1
"""Exit code if a check has failed; warnings are no failures."""
_STYLES = {Level.OK: "green", Level.WARNING: "yellow", Level.FAILED: "bold red"}


def doctor(
    connect: Annotated[
        str | None,
        typer.Option(
            "--connect",
            metavar="ADDRESS",
            help="Also check the run at this address, or that of this folder of a run.",
        ),
    ] = None,
    run: LiveRunOption = None,
    as_json: JsonOption = False,
    run_file: RunFileOption = None,
    settings: SetOption = None,
    certificates: CertificatesOption = None,
) -> None:
    """Check whether this installation and this machine are ready for a run, and the state of a live run."""
    with contextlib.suppress(CommandError):  # on a machine that only runs actors
        runs.declare_installed_planners()
    if connect is not None:
        folder_in(connect)  # its certificates are checked, too
    checks = _checks(runs.new_settings(run_file, overrides(settings)), connect, run)
    console = Console(soft_wrap=True, highlight=False)
    found: list[Finding] = []
    for finding in (finding for name, check in checks for finding in findings_of(name, check)):
        found.append(finding)
        if not as_json:
            console.print(line(finding))
    if as_json:
        print(json.dumps(facts(found)))
    else:
        console.print(verdict(found))
    if any(finding.level is Level.FAILED for finding in found):
        raise typer.Exit(FAILED)


def facts(found: list[Finding]) -> dict[str, object]:
    """Return the report as plain values."""
    levels = [finding.level for finding in found]
    return {
        "ok": Level.FAILED not in levels,
        "failed": levels.count(Level.FAILED),
        "warnings": levels.count(Level.WARNING),
        "checks": [asdict(finding) for finding in found],
    }


def line(finding: Finding) -> Text:
    """Return a finding as one line."""
    text = Text(f"{finding.level:8}", style=_STYLES[finding.level])
    text.append(f"{finding.check}: ", style="not bold default").append(finding.seen, style="not bold default")
    if finding.remedy:
        text.append(f"; {finding.remedy}", style="bold default")
    return text


def verdict(found: list[Finding]) -> str:
    """Return the last line."""
    levels = [finding.level for finding in found]
    checks = counted(len(found), "check")
    warnings = counted(levels.count(Level.WARNING), "warning")
    return f"{checks}, {warnings}, {levels.count(Level.FAILED)} failed"


def _checks(settings: RunFile, connect: str | None, run: str | None) -> Iterator[tuple[str, Check]]:
    """Yield the checks with their names; without an address the learner will run here."""
    yield "installation", installation.installation
    yield "cores", machine.cores
    yield "memory", lambda: machine.memory(settings)
    yield "disk", lambda: disk.disk(settings)
    yield "simulation", machine.simulation
    if connect is None:
        yield "towns", lambda: machine.towns(settings)
        yield "port", lambda: network.port(settings)
    yield "certificates", lambda: network.certificates(settings)
    yield "delivery", lambda: round_trip.round_trip(settings)
    if connect is not None:
        yield "learner", lambda: live_run.live_run(learner_address(connect), run)
