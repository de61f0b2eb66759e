"""`athrl study`: a grid of runs or a search over settings, as one folder with a table and curves."""

from __future__ import annotations

import importlib
import os
import shlex
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from athrl_spaces.wording import counted

from athrl import runs
from athrl.errors import CommandError, needs, say
from athrl.options import given_folder
from athrl.service_names import program
from athrl.stopping import stop_on_signal
from athrl.study.curves import picture
from athrl.study.earlier import read_earlier, take_over
from athrl.study.file import StudyFile, read_study_file
from athrl.study.folder import StudyFolder
from athrl.study.grid import GridRunner
from athrl.study.identity import identity
from athrl.study.origin import origin
from athrl.study.places import require_places, require_room_at_home
from athrl.study.plan import PlannedRun, planned_runs, require_search
from athrl.study.runs import Stopped
from athrl.study.search import Search, search_table
from athrl.study.table import as_csv, markdown, tabulated
from athrl.train.command import INTERRUPTED
from athrl.train.plan import require_services
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
    jobs: Annotated[
        int, typer.Option(min=1, help="Number of runs at once, each on its share of the cores.")
    ] = 1,
    earlier: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="FILE",
            help="study.json of this study from another machine: its finished runs are not repeated.",
        ),
    ] = None,
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
        if earlier is not None:
            raise CommandError(f"--from {earlier}: a search has its trials in search.db, copy the folder")
    known = read_earlier(earlier, wanted, planned) if earlier is not None else {}
    folder = StudyFolder(out if out is not None else Path("runs") / f"study-{wanted.study.name}")
    with folder.locked(shared=optimise):
        folder.claim(wanted, planned)
        if known:
            count = take_over(known, folder, wanted, planned)
            say(f"{earlier}: {counted(count, 'finished run')} taken over")
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
    try:
        GridRunner(wanted, folder, stop, say, jobs).run_all(planned)
    finally:
        found = {**tabulated(wanted, planned, folder), "begun": identity(wanted, planned)}
        _write(folder, found)
    print(markdown(found), end="")
    print(f"table: {folder.path / 'table.md'}")
    return bool(found["failures"])


def _search(file: Path, wanted: StudyFile, folder: StudyFolder, stop: threading.Event) -> bool:
    """Work on the search, and write what it found, also when stopped; return if a trial failed."""
    search = Search(file, wanted, folder, stop, say)
    try:
        search.run()
    finally:
        found = {**search.found(), "made": origin()}
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
