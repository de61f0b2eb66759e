"""The runs of a grid: each is trained, scored and noted, as many at once as is wanted."""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from functools import partial
from pathlib import Path
from typing import Any

from athrl.ports import free_address
from athrl.study import learning
from athrl.study.file import ElsewhereSection, StudyFile
from athrl.study.folder import StudyFolder
from athrl.study.origin import origin
from athrl.study.places import Place, elsewhere, home
from athrl.study.plan import PlannedRun
from athrl.study.runs import RunFailed, Stopped, train, train_words
from athrl.study.scores import evaluated
from athrl.train.plan import usable_cores

Say = Callable[[str], None]

_LONGEST_TOWN = 40
"""Characters of a town in the name of a file."""


class GridRunner:
    """Brings runs to their end in the folder of a study.

    Args:
        study: how they are scored, and how long one may take.
        folder: where they are and what they came to is noted.
        stop: drains the runs when it is set.
        say: shows a line to the user.
        jobs: how many at once.
    """

    def __init__(
        self, study: StudyFile, folder: StudyFolder, stop: threading.Event, say: Say, jobs: int = 1
    ) -> None:
        self._study = study
        self._folder = folder
        self._stop = stop
        self._say = say
        self._jobs = jobs

    def run_all(self, runs: Sequence[PlannedRun]) -> None:
        """Bring every run to its end and score the reference drivers; a failure is noted, the others go on.

        Raises:
            Stopped: the runs that were under way are drained.
            CommandError: the folder cannot be written.
        """
        tasks: list[Callable[[], object]] = [partial(self._run_and_score_elsewhere, run) for run in runs]
        for run in _one_a_row_of_towns(runs):
            tasks += [partial(self._score_driver, driver, run) for driver in self._study.study.drivers]
        for section in self._study.elsewhere:
            for driver in self._study.study.drivers:
                tasks.append(partial(self._score_driver_elsewhere, driver, runs[0], section))
        shares = iter(shares_of_cores(sorted(os.sched_getaffinity(0)), self._jobs))
        with ThreadPoolExecutor(self._jobs, initializer=lambda: _keep_to(next(shares))) as pool:
            futures = [pool.submit(task) for task in tasks]
            _, waiting = wait(futures, return_when=FIRST_EXCEPTION)
            if waiting:  # one has raised: nothing else is started, what is under way is drained
                self._stop.set()
                wait(waiting)
        errors = [error for future in futures if (error := future.exception()) is not None]
        for error in sorted(errors, key=lambda error: isinstance(error, Stopped)):
            raise error

    def run(self, run: PlannedRun, look: Callable[[], None] = lambda: None) -> dict[str, Any]:
        """Bring one run to its end and return what it came to, finished or failed; raises as `run_all` does.

        `look` is called again and again while it trains; what it raises drains the run and is passed on.
        """
        known = self._folder.result(run.name)
        if known is not None and "failure" not in known:
            return known
        if self._stop.is_set():
            raise Stopped
        result: dict[str, Any] = {
            "run": run.name,
            "planner": run.row.planner,
            "town": run.row.town,
            "variant": run.row.variant,
            "seed": run.seed,
            "made": origin(),
        }
        try:
            result |= self._trained(run, look)
            result["scores"] = self._scored(run)
            self._say(f"{run.name}: {in_words(result['scores'])}")
        except RunFailed as error:
            result["failure"] = str(error)
            self._say(f"{run.name} failed: {error}")
        self._folder.note(run.name, result)
        return result

    def _trained(self, run: PlannedRun, look: Callable[[], None]) -> dict[str, Any]:
        """Train, and return what the run's folder tells of it."""
        folder = self._folder.runs / run.name
        address = free_address()
        decisions = run.settings.run.environment_steps
        self._say(f"{run.name}: {decisions:,} decisions, log {self._folder.log(run.name)}; learner {address}")
        seconds = train(
            folder,
            lambda: train_words(folder, run.overrides, run_file=run.run_file, address=address),
            decisions,
            self._folder.log(run.name),
            self._stop,
            limit_seconds=3600 * self._study.study.hours_a_run,
            look=look,
        )
        earlier = self._folder.result(run.name) or {}
        curves = learning.training_curves(folder)
        scores = learning.scores_on_the_way(folder)
        return {
            "decisions": decisions,
            "seconds": seconds if seconds is not None else earlier.get("seconds"),
            "training": learning.averages(curves, after=run.settings.exploration.random_decisions),
            "curves": {
                "training": learning.thinned(curves["return_mean"], decisions),
                "greedy": learning.thinned(scores, decisions),
            },
        }

    def _scored(self, run: PlannedRun) -> dict[str, float]:
        return self._evaluated(str(self._policy(run)), run, home(self._study, run), run.name)

    def _policy(self, run: PlannedRun) -> Path:
        return self._folder.runs / run.name / "policies" / "latest.onnx"

    def _run_and_score_elsewhere(self, run: PlannedRun) -> None:
        """Bring one run to its end, and score what it learnt in the places of the study."""
        result = self.run(run)
        if "failure" in result:
            return
        for section in self._study.elsewhere:
            facts = {"run": run.name, "place": section.name}
            name = name_elsewhere(run.name, section.name)
            self._note_scores(name, facts, str(self._policy(run)), run, elsewhere(self._study, section))

    def _score_driver(self, driver: str, run: PlannedRun) -> None:
        """Score a reference driver at a run's home."""
        name = driver_name(driver, run.row.town)
        facts = {"driver": driver, "town": run.row.town}
        self._note_scores(name, facts, driver, run, home(self._study, run))

    def _score_driver_elsewhere(self, driver: str, run: PlannedRun, section: ElsewhereSection) -> None:
        """Score a reference driver in a place of the study, with a run's settings."""
        name = name_elsewhere(f"driver-{driver}", section.name)
        facts = {"driver": driver, "place": section.name}
        self._note_scores(name, facts, driver, run, elsewhere(self._study, section))

    def _note_scores(
        self, name: str, facts: Mapping[str, Any], driver: str, run: PlannedRun, place: Place
    ) -> None:
        """Score a driver and note it, or why it failed, unless that is done; raises as `run_all` does."""
        known = self._folder.result(name)
        if known is not None and "failure" not in known:
            return
        result = dict(facts)
        try:
            result["scores"] = self._evaluated(driver, run, place, name)
        except RunFailed as error:
            result["failure"] = str(error)
            self._say(f"{name} failed: {error}")
        self._folder.note(name, result)

    def _evaluated(self, driver: str, run: PlannedRun, place: Place, name: str) -> dict[str, float]:
        words = place.words(driver, run.settings.environment)
        log = self._folder.log(f"{name}-scores")
        return evaluated(words, log, self._stop, threads=usable_cores())


def shares_of_cores(cores: Sequence[int], jobs: int) -> list[set[int]]:
    """Return the cores of each of so many jobs; if there are more jobs than cores, some share one."""
    count = len(cores)
    return [
        set(cores[job * count // jobs : (job + 1) * count // jobs]) or {cores[job % count]}
        for job in range(jobs)
    ]


def _keep_to(cores: set[int]) -> None:
    """Keep this thread, and the processes that it will start, to these cores."""
    os.sched_setaffinity(0, cores)


def driver_name(driver: str, town: str) -> str:
    """Return under which name a reference driver's scores in a town, or in several, are kept."""
    name = town.replace("/", "_")
    if len(name) > _LONGEST_TOWN:  # paths of maps; a file name has at most 255 bytes
        name = f"{name[:_LONGEST_TOWN]}-{hashlib.sha256(town.encode()).hexdigest()[:12]}"
    return f"driver-{driver}-{name}"


def name_elsewhere(name: str, place: str) -> str:
    """Return under which name the scores of a run or driver in a place of the study are kept."""
    return f"{name}@{place}"


def in_words(scores: dict[str, float]) -> str:
    """Return the most important scores in a line."""
    return (
        f"return {scores['return_mean']:.0f}, {scores['speed_mps']:.2f} m/s, "
        f"collisions {scores['collision_rate']:.1%}, off lane {scores['off_lane_rate']:.1%}"
    )


def _one_a_row_of_towns(runs: Sequence[PlannedRun]) -> list[PlannedRun]:
    """Return the first run in each town, or towns, whose environment the reference drivers get."""
    return list({run.row.towns: run for run in reversed(runs)}.values())[::-1]
