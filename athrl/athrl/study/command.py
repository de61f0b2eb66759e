"""`athrl study`: a grid of runs or a search over settings, as one folder with a table and curves."""

from __future__ import annotations

import importlib
import os
import platform
import shlex
import subprocess
import threading
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer

from athrl import runs
from athrl.errors import CommandError, needs, say
from athrl.options import given_folder
from athrl.service_names import program
from athrl.stopping import stop_on_signal
from athrl.study.curves import picture
from athrl.study.file import StudyFile, read_study_file
from athrl.study.folder import StudyFolder
from athrl.study.grid import GridRunner
from athrl.study.places import require_places, require_room_at_home
from athrl.study.plan import PlannedRun, planned_runs, require_search
from athrl.study.runs import Stopped
from athrl.study.search import Search, search_table
from athrl.study.table import as_csv, markdown, tabulated
from athrl.train.command import INTERRUPTED
from athrl.train.plan import require_services, usable_cores
from athrl.train.session import STOP_SECONDS

FAILED = 1
"""Exit code of a study with a run that failed."""


def study(
    file: Annotated[Path, typer.Argument(metavar="STUDY", help="TOML file of the study.")],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            parser=given_folder,
            help="Folder of the study; by default runs/study-NAME.",
        ),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Number of runs at once.")] = 1,
    optimise: Annotated[
        bool, typer.Option("--optimise", help="Search over the settings of the file's table [search].")
    ] = False,
) -> None:
    """Train every run of a study, score it on held-out episodes, and write a table and curves.

    Ctrl-C drains the present runs. The same command continues the study, and tries again what failed.
    """
    require_services()
    _require_libraries(["matplotlib.figure", "scipy.stats", *(["optuna"] if optimise else [])])
    runs.declare_installed_planners()
    _take_settings_from_the_file_alone()
    wanted = read_study_file(file)
    planned = planned_runs(file, wanted)
    require_places(file, wanted, planned)
    if optimise:
        require_room_at_home(file, require_search(file, wanted))
        if jobs > 1:
            raise CommandError(
                f"--jobs {jobs}: with --optimise a worker has one run at once; start more workers instead"
            )
    folder = StudyFolder(out if out is not None else Path("runs") / f"study-{wanted.study.name}")
    with folder.locked(shared=optimise):
        folder.claim(wanted, planned)
        with stop_on_signal(within=2 * STOP_SECONDS) as stop:
            try:
                if optimise:
                    failed = _search(file, wanted, folder, stop)
                else:
                    failed = _run_grid(wanted, planned, folder, stop, jobs)
            except Stopped:
                say(f"stopped; to continue: {_to_continue(file, folder, jobs, optimise)}")
                raise typer.Exit(INTERRUPTED) from None
    if failed:
        raise typer.Exit(FAILED)


def _run_grid(
    wanted: StudyFile, planned: Sequence[PlannedRun], folder: StudyFolder, stop: threading.Event, jobs: int
) -> bool:
    """Bring all runs to their end, and write what they came to, also when stopped; return if one failed."""
    began = time.strftime("%Y-%m-%d")
    try:
        GridRunner(wanted, folder, stop, say, jobs).run_all(planned)
    finally:
        found = {**tabulated(wanted, planned, folder), "made": _made(began)}
        _write(folder, found)
    print(markdown(found), end="")
    print(f"table: {folder.path / 'table.md'}")
    return bool(found["failures"])


def _search(file: Path, wanted: StudyFile, folder: StudyFolder, stop: threading.Event) -> bool:
    """Work on the search, and write what it found, also when stopped; return if a trial failed."""
    began = time.strftime("%Y-%m-%d")
    search = Search(file, wanted, folder, stop, say)
    try:
        search.run()
    finally:
        found = {**search.found(), "made": _made(began)}
        folder.write_json("search.json", found)
        folder.write("search.md", search_table(found))
    print(search_table(found), end="")
    return any(trial["state"] == "fail" for trial in found["trials"])


def _write(folder: StudyFolder, found: dict[str, Any]) -> None:
    """Write the study's JSON, its tables and its picture."""
    folder.write_json("study.json", found)
    folder.write("table.md", markdown(found))
    folder.write("table.csv", as_csv(found))
    content = picture(found)
    if content is not None:
        folder.write("curves.png", content)


def _made(date: str) -> dict[str, Any]:
    """Return with what and where the figures were made, as far as that is known."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=10)
        commit = done.stdout.strip()
    except (OSError, subprocess.TimeoutExpired):  # no git
        commit = ""
    return {
        "version": version("athrl"),
        "commit": commit,
        "date": date,
        "cores": usable_cores(),
        "processor": _processor(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


def _take_settings_from_the_file_alone() -> None:
    """Keep the variables that change settings from the study's runs: its file says everything."""
    for name in ("ATHRL_SET", "ATHRL_RUN_FILE"):
        if os.environ.pop(name, None):
            say(f"{name} is not used: the settings of a study are in its file")


def _require_libraries(names: Sequence[str]) -> None:
    """Raise CommandError if a library that is needed after hours of training is missing."""
    with needs("study"):
        for name in names:
            importlib.import_module(name)


def _to_continue(file: Path, folder: StudyFolder, jobs: int, optimise: bool) -> str:
    words = [program("athrl"), "study", str(file), "--out", str(folder.path)]
    words += ["--jobs", str(jobs)] if jobs > 1 else []
    words += ["--optimise"] if optimise else []
    return shlex.join(words)
