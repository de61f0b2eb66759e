"""Which run is meant: its settings and its folder, of a new run and of one that is resumed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from athrl_protocol.run_file import RunFile, declare_planners, read_run_file

from athrl.errors import CommandError, needs


def know_planners() -> None:
    """Have run files held to the settings of the planners that are installed; to start a run.

    It needs no torch.

    Raises:
        CommandError: the planners are not installed.
        UnknownPlanner: an installed package brings along a planner that cannot be loaded, or held to.
    """
    with needs("learner"):
        from athrl_planners.registry import UnknownPlanner, settings_tables
    tables = settings_tables()
    try:
        declare_planners(tables)
    except ValueError as error:
        raise UnknownPlanner(str(error)) from None


def run_folder(settings: RunFile) -> Path:
    """Return the folder of the run that has these settings."""
    return Path(settings.run.folder) / settings.run.name


def holds_run(folder: Path) -> bool:
    """Return whether a run has been written into the folder."""
    return (folder / "run.toml").is_file()


def new_settings(run_file: Path | None, overrides: Sequence[str], *, training: bool = True) -> RunFile:
    """Read the settings of a new run, or of driving alone; without a run file they are the defaults.

    Raises:
        RunFileError: a key or a value is wrong.
    """
    return read_run_file(run_file, overrides, training=training)


def resumed_settings(run: str, overrides: Sequence[str]) -> tuple[RunFile, Path]:
    """Return the settings and the folder of an earlier run.

    Args:
        run: the run's folder, or its name in the default folder or in the one that an override names.
        overrides: settings that are to differ from now on.

    Raises:
        CommandError: there is no such run, or it is another planner's than an override wants.
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
    began = read_run_file(folder / "run.toml", complete=True)
    _require_same_planner(folder, began, overrides)
    # Where the folder is found is where the run is resumed: it may have been moved, or be mounted elsewhere.
    found = [f"run.folder={folder.parent}", f"run.name={folder.name}"]
    return read_run_file(folder / "run.toml", [*overrides, *found], complete=True), folder


def _require_same_planner(folder: Path, began: RunFile, overrides: Sequence[str]) -> None:
    """Refuse another planner: it has other networks, and would take other settings."""
    for override in overrides:
        name, _, kind = (part.strip() for part in override.partition("="))
        if name == "planner.kind" and kind.strip("\"'") != began.planner.kind:
            raise CommandError(
                f"--set {override}: {folder} is a run of the planner {began.planner.kind} and is resumed as "
                "one only: leave planner.kind out, or start another run"
            )


def unused_name(settings: RunFile) -> str:
    """Return the run's name, with a number behind it where the folder of that name holds a run already."""
    name = settings.run.name
    number = 1
    while holds_run(Path(settings.run.folder) / name):
        number += 1
        name = f"{settings.run.name}-{number}"
    return name
