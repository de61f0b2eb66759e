"""Settings and folder of a run, new or resumed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from athrl_protocol import RunFileError
from athrl_protocol.run_file import (
    EnvironmentSection,
    RunFile,
    are_other_towns,
    declare_planners,
    read_run_file,
    settings,
)
from athrl_protocol.run_file.toml_values import to_toml_value

from athrl.errors import CommandError, needs


def declare_installed_planners() -> None:
    """Check run files against the settings of the installed planners from now on.

    Does not need torch.

    Raises:
        CommandError: the planners are not installed.
        UnknownPlanner: a planner of an installed package cannot be loaded or has invalid settings.
    """
    with needs("learner"):
        from athrl_planners.registry import UnknownPlanner, settings_tables
    tables = settings_tables()
    try:
        declare_planners(tables)
    except ValueError as error:
        raise UnknownPlanner(str(error)) from None


def run_folder(run: RunFile) -> Path:
    """Return the folder of the run that has these settings."""
    return Path(run.run.folder) / run.run.name


def holds_run(folder: Path) -> bool:
    """Return whether a run has been written into the folder."""
    return (folder / "run.toml").is_file()


def new_settings(run_file: Path | None, overrides: Sequence[str], *, training: bool = True) -> RunFile:
    """Read the settings of a new run, or for driving only; without a run file the defaults.

    Raises:
        RunFileError: a key or a value is not valid.
    """
    return read_run_file(run_file, overrides, training=training)


def folder_asked_for(run_file: Path | None, overrides: Sequence[str]) -> Path:
    """Return the folder of the run that is asked for, which may hold a run already.

    Raises:
        RunFileError: the run file, or an override of the run's name or folder, is not valid.
    """
    # The other settings belong to the run's own, which are not known yet.
    where = [each for each in overrides if each.partition("=")[0].strip() in ("run.folder", "run.name")]
    return run_folder(read_run_file(None, where, training=False, changes=run_file))


def resumed_settings(
    run: str, overrides: Sequence[str], run_file: Path | None = None
) -> tuple[RunFile, Path]:
    """Return the settings and the folder of an earlier run: its own, but for those that are given.

    Args:
        run: the run's folder, or its name in the default folder or that of an override.
        overrides: settings to change.
        run_file: a file with settings to change; `overrides` override these.

    Raises:
        CommandError: there is no such run, or it is to have another planner.
        RunFileError: its run file, the other one or an override is not valid.
    """
    parent = folder_asked_for(run_file, overrides).parent
    folder = Path(run) if holds_run(Path(run)) else parent / run
    folder = folder if folder.name else folder.resolve()  # such as "."
    if not holds_run(folder):
        known = sorted(path.name for path in parent.glob("*") if holds_run(path))
        there = f"runs there: {', '.join(known)}" if known else "no run is there"
        raise CommandError(f"no run {run!r} in {parent}/ to resume; {there}")
    began = read_run_file(folder / "run.toml", complete=True)
    _require_same_planner(folder, began, overrides)
    require_name(folder.name, f"the folder {folder} has the name of its run")
    # The run is resumed in the folder where it was found: it may have been moved, or be mounted elsewhere.
    found = [f"run.folder={to_toml_value(str(folder.parent))}", f"run.name={to_toml_value(folder.name)}"]
    resumed = read_run_file(folder / "run.toml", [*overrides, *found], complete=True, changes=run_file)
    if resumed.planner.kind != began.planner.kind:
        raise CommandError(_other_planner(f"{run_file}: planner.kind", folder, began))
    return _with_checksums_of(began, resumed), folder


def _with_checksums_of(began: RunFile, resumed: RunFile) -> RunFile:
    """The resumed settings with the known checksums of maps: a whole run file that is given has none."""
    checksums = {**resumed.run.map_checksums, **began.run.map_checksums}
    return resumed.model_copy(update={"run": resumed.run.model_copy(update={"map_checksums": checksums})})


def told_other_towns(folder: Path, resumed: RunFile) -> str:
    """Return one line if a run goes on in other towns than before; empty if in the same, or moved maps.

    Raises:
        RunFileError: a map in place of the run's has its file name and another content.
    """
    began = read_run_file(folder / "run.toml", complete=True)
    if not are_other_towns(began, resumed):
        return ""
    was, now = (", ".join(settings.environment.towns) for settings in (began, resumed))
    return f"{folder} goes on in another town than before: was {was}, is {now}"


def require_same_environments(folder: Path, resumed: RunFile) -> None:
    """Raise CommandError for a serial run with other environments: it drives its episodes again to resume."""
    if not resumed.serial.enabled:
        return
    began = read_run_file(folder / "run.toml", complete=True)
    for name in EnvironmentSection.model_fields:
        was, now = (getattr(settings.environment, name) for settings in (began, resumed))
        if name == "towns":  # a moved map is the same town
            differs = are_other_towns(began, resumed) or list(was.values()) != list(now.values())
        else:
            differs = was != now
        if differs:
            raise CommandError(
                f"environment.{name} was {was}, is {now}: a serial run can only be resumed with the same "
                "environments, in which it drives its open episodes again"
            )


def require_name(name: str, place: str) -> None:
    """Raise CommandError, which begins with `place`, unless a run may have this name."""
    try:
        read_run_file(None, [f"run.name={to_toml_value(name)}"], training=False)
    except RunFileError:
        expected = next(setting.expected for setting in settings() if setting.name == "run.name")
        raise CommandError(f"{place}: should be {expected}") from None


def _require_same_planner(folder: Path, began: RunFile, overrides: Sequence[str]) -> None:
    """Refuse another planner: it has other networks and settings."""
    for override in overrides:
        name, _, kind = (part.strip() for part in override.partition("="))
        if name == "planner.kind" and kind.strip("\"'") != began.planner.kind:
            raise CommandError(_other_planner(f"--set {override}", folder, began))


def _other_planner(place: str, folder: Path, began: RunFile) -> str:
    return (
        f"{place}: {folder} is a run of the planner {began.planner.kind} and can only be "
        "resumed as one: leave planner.kind out, or start another run"
    )


def unused_name(run: RunFile) -> str:
    """Return the run's name, with a number appended if the folder of that name already holds a run."""
    name = run.run.name
    number = 1
    while holds_run(Path(run.run.folder) / name):
        number += 1
        name = f"{run.run.name}-{number}"
    return name
