"""Which run is meant: its settings and its folder, of a new run and of one that goes on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from athrl_protocol.run_file import RunFile, read_run_file

from athrl.errors import CommandError


def run_folder(settings: RunFile) -> Path:
    """Return the folder of the run that has these settings."""
    return Path(settings.run.folder) / settings.run.name


def holds_run(folder: Path) -> bool:
    """Return whether a run has been written into the folder."""
    return (folder / "run.toml").is_file()


def new_settings(run_file: Path | None, overrides: Sequence[str]) -> RunFile:
    """Read the settings of a new run; without a run file they are the defaults.

    Raises:
        RunFileError: a key or a value is wrong.
    """
    return read_run_file(run_file, overrides)


def resumed_settings(run: str, overrides: Sequence[str]) -> tuple[RunFile, Path]:
    """Return the settings and the folder of an earlier run.

    Args:
        run: the run's folder, or its name in the default folder or in the one that an override names.
        overrides: settings that are to differ from now on.

    Raises:
        CommandError: there is no such run.
        RunFileError: its run file or an override is wrong.
    """
    # The other overrides belong to the run's own settings, which are not known yet.
    where = [override for override in overrides if override.partition("=")[0].strip() == "run.folder"]
    parent = Path(read_run_file(None, where).run.folder)
    folder = Path(run) if holds_run(Path(run)) else parent / run
    if not holds_run(folder):
        known = sorted(path.name for path in parent.glob("*") if holds_run(path))
        there = f"runs there: {', '.join(known)}" if known else "no run is there"
        raise CommandError(f"no run {run!r} in {parent}/ to resume; {there}")
    # Where the folder is found is where the run goes on: it may have been moved, or be mounted elsewhere.
    found = [f"run.folder={folder.parent}", f"run.name={folder.name}"]
    return read_run_file(folder / "run.toml", [*overrides, *found], complete=True), folder


def unused_name(settings: RunFile) -> str:
    """Return the run's name, with a number behind it where the folder of that name holds a run already."""
    name = settings.run.name
    number = 1
    while holds_run(Path(settings.run.folder) / name):
        number += 1
        name = f"{settings.run.name}-{number}"
    return name
