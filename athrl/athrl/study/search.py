"""A search over settings with Optuna: trials in a SQLite file, by one worker or several on the same folder.

A trial belongs to the worker that holds its lock, which ends with its process. A trial that is not ended and
whose lock is free, of a worker that was stopped or killed, is continued by the next worker that looks.
"""

from __future__ import annotations

import fcntl
import json
import statistics
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from athrl_protocol.run_file.toml_values import to_toml_value

from athrl.errors import CommandError, needs
from athrl.study.file import SearchSection, StudyFile
from athrl.study.folder import StudyFolder
from athrl.study.grid import GridRunner, Say
from athrl.study.learning import scores_on_the_way
from athrl.study.plan import PlannedRun, planned_runs

if TYPE_CHECKING:
    import optuna

TENTHS = 10
"""Of a run's decisions: a trial is compared with the earlier ones once in each."""
LOCK_SECONDS = 120.0
"""How long a worker waits for the others to choose their trials, and for the file of the search."""
POLL_SECONDS = 0.1


class Pruned(Exception):  # noqa: N818  (the name says what happened)
    """A trial does worse on the way than half of the earlier ones did."""


class TrialFailed(Exception):  # noqa: N818  (the name says what happened)
    """The settings of a trial do not fit each other, or one of its runs failed; one line."""


class Search:
    """One worker of a search.

    Raises:
        CommandError: Optuna is not installed, or the file of the search cannot be used.
    """

    def __init__(self, path: Path, study: StudyFile, folder: StudyFolder, stop: threading.Event, say: Say):
        assert study.search is not None
        self._path = path
        self._study = study
        self._wanted: SearchSection = study.search
        self._folder = folder
        self._stop = stop
        self._say = say
        self._runner = GridRunner(study, folder, stop, say)
        self._locks = folder.path / "trials"
        self._locks.mkdir(exist_ok=True)
        self._file = folder.path / "search.db"
        with self._alone(), _file_errors(self._file):
            self._optuna_study = _opened(self._file, study)

    def run(self) -> None:
        """Work on trials until there are as many as are wanted, each ended or in the hands of a worker.

        Raises:
            Stopped: the present trial is drained; the next worker continues it.
            CommandError: the folder cannot be written.
        """
        with _file_errors(self._file):
            while (taken := self._take()) is not None:
                trial, lock = taken
                with lock:
                    self._bring_to_its_end(trial)

    def _take(self) -> tuple[optuna.Trial, IO[bytes]] | None:
        """Return an abandoned trial, else the next one, with its lock; None if there are enough."""
        import optuna

        with self._alone():
            trials = self._optuna_study.get_trials(deepcopy=False)
            for known in trials:
                if known.state is optuna.trial.TrialState.RUNNING:
                    lock = self._lock_of(known.number)
                    if lock is not None and self._is_whole(known, lock):
                        # The number that Optuna gives a trial in its storage has no public name.
                        return optuna.Trial(self._optuna_study, known._trial_id), lock
            if len(trials) >= self._wanted.trials:
                return None
            trial = self._optuna_study.ask(_distributions(self._wanted))
            lock = self._lock_of(trial.number)
            assert lock is not None  # nobody else knows of it yet
            return trial, lock

    def _is_whole(self, known: optuna.trial.FrozenTrial, lock: IO[bytes]) -> bool:
        """Return whether an abandoned trial has all its settings; one that was killed before has failed."""
        import optuna

        if known.params.keys() == self._wanted.ranges.keys():
            return True
        self._optuna_study.tell(known.number, state=optuna.trial.TrialState.FAIL)
        lock.close()
        return False

    def _lock_of(self, number: int) -> IO[bytes] | None:
        """Return the lock of a trial, held by this process; None if another worker holds it."""
        lock = (self._locks / f"{number:04d}.lock").open("ab")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            return None
        return lock

    def _bring_to_its_end(self, trial: optuna.Trial) -> None:
        import optuna

        self._say(f"trial {trial.number}: {_settings_of(trial)}")
        try:
            value = self._value(trial)
        except Pruned:
            self._say(f"trial {trial.number}: below the median of the earlier ones, ended")
            self._optuna_study.tell(trial, state=optuna.trial.TrialState.PRUNED)
            return
        except TrialFailed as error:
            self._say(f"trial {trial.number} failed: {error}")
            trial.set_user_attr("failure", str(error))
            self._optuna_study.tell(trial, state=optuna.trial.TrialState.FAIL)
            return
        self._say(f"trial {trial.number}: {self._wanted.objective} {value:g}")
        self._optuna_study.tell(trial, value)

    def _value(self, trial: optuna.Trial) -> float:
        """Train and score the runs of a trial; return the mean of the objective over them.

        Raises:
            Pruned: it is not worth it.
            TrialFailed: the settings do not fit each other, or a run failed.
            CommandError: the folder cannot be read or written, which no other trial would change.
        """
        grid = [
            each.model_copy(update={"settings": [*each.settings, *_settings(trial)]})
            for each in self._study.grid
        ]
        changed = self._study.model_copy(update={"grid": grid})
        try:
            planned = planned_runs(self._path, changed, f"t{trial.number:04d}-")
        except CommandError as error:
            raise TrialFailed(str(error)) from None
        found = []
        for order, run in enumerate(planned):
            result = self._runner.run(run, self._look(trial, order, run))
            if "failure" in result:
                raise TrialFailed(f"{run.name}: {result['failure']}")
            found.append(float(result["scores"][self._wanted.objective]))
        return statistics.fmean(found)

    def _look(self, trial: optuna.Trial, order: int, run: PlannedRun) -> Callable[[], None]:
        """Return what is called while a run trains: tells Optuna its scores, and asks whether to go on."""
        folder, decisions = self._folder.runs / run.name, run.settings.run.environment_steps
        told = self._reported(trial.number)  # by the worker before, if the trial was abandoned

        def look() -> None:
            for steps, score in scores_on_the_way(folder, self._wanted.objective):
                tenth = order * TENTHS + min(TENTHS - 1, TENTHS * steps // decisions)
                if tenth in told:
                    continue
                told.add(tenth)
                trial.report(score, tenth)
                if trial.should_prune():
                    raise Pruned

        return look if self._wanted.prune else lambda: None

    def _reported(self, number: int) -> set[int]:
        """Return at which tenths a trial has been compared already."""
        trials = self._optuna_study.get_trials(deepcopy=False)
        return set(next(trial for trial in trials if trial.number == number).intermediate_values)

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Hold the choice of trials; raises CommandError if another worker does not let go of it in time."""
        deadline = time.monotonic() + LOCK_SECONDS
        with (self._locks / "choice.lock").open("ab") as lock:
            while True:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    if time.monotonic() > deadline:
                        raise CommandError(
                            f"another worker has held {lock.name} for {LOCK_SECONDS:.0f} s: stop it"
                        ) from None
                    time.sleep(POLL_SECONDS)
            yield

    def found(self) -> dict[str, Any]:
        """Return all trials and the best one, for `search.json`.

        Raises:
            CommandError: the file of the search cannot be read.
        """
        with _file_errors(self._file):
            known = self._optuna_study.get_trials(deepcopy=False)
        trials: list[dict[str, Any]] = [
            {
                "trial": trial.number,
                "state": trial.state.name.lower(),
                "value": trial.value if trial.state.name == "COMPLETE" else None,
                "settings": trial.params,
                "failure": trial.user_attrs.get("failure"),
            }
            for trial in known
        ]
        done = [trial for trial in trials if trial["value"] is not None]
        best = max if self._wanted.direction == "maximise" else min
        return {
            "study": self._study.study.name,
            "objective": self._wanted.objective,
            "direction": self._wanted.direction,
            "wanted": self._wanted.trials,
            "trials": trials,
            "best": best(done, key=lambda trial: trial["value"]) if done else None,
        }


def search_table(found: dict[str, Any]) -> str:
    """Return what `Search.found` returned as a Markdown table, the best trial in a line below it."""
    names = list(dict.fromkeys(name for trial in found["trials"] for name in trial["settings"]))
    head = ["trial", "state", found["objective"], *(f"`{name}`" for name in names)]
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for trial in found["trials"]:
        value = "" if trial["value"] is None else f"{trial['value']:g}"
        cells = [_shown(trial["settings"].get(name, "")) for name in names]
        lines.append(f"| {' | '.join([str(trial['trial']), trial['state'], value, *cells])} |")
    if found["best"] is not None:
        best = found["best"]["settings"]
        words = " ".join(f"--set {name}={to_toml_value(value)}" for name, value in best.items())
        lines += ["", f"Best: trial {found['best']['trial']}, `{words}`."]
    return "\n".join(lines) + "\n"


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@contextmanager
def _file_errors(file: Path) -> Iterator[None]:
    """Turn what Optuna raises inside the block when it cannot use its file into a `CommandError`."""
    with needs("study"):
        from optuna.exceptions import StorageInternalError
        from sqlalchemy.exc import SQLAlchemyError
    try:
        yield
    except (StorageInternalError, SQLAlchemyError) as error:
        # Optuna's own text is about something else; what SQLite says is in the innermost error.
        cause = error.__cause__ if isinstance(error, StorageInternalError) else error
        raise CommandError(
            f"the file of the search {file} cannot be used: {getattr(cause, 'orig', None) or error}"
        ) from error


def _opened(file: Path, study: StudyFile) -> optuna.Study:
    """Open the search in its SQLite file, new or as others left it; raises CommandError if it cannot."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    assert study.search is not None
    try:
        storage = optuna.storages.RDBStorage(
            f"sqlite:///{file}", engine_kwargs={"connect_args": {"timeout": LOCK_SECONDS}}
        )
    except RuntimeError:  # so it refuses the tables of another version
        raise CommandError(
            f"the file of the search {file} is of another version of Optuna than {optuna.__version__}: "
            "install the version that began the search, or name another folder with --out"
        ) from None
    return optuna.create_study(
        study_name=study.study.name,
        storage=storage,
        direction="maximize" if study.search.direction == "maximise" else "minimize",
        sampler=optuna.samplers.TPESampler(),
        pruner=optuna.pruners.MedianPruner(n_warmup_steps=TENTHS // 3),
        load_if_exists=True,
    )


def _distributions(search: SearchSection) -> dict[str, Any]:
    """Return Optuna's distribution of each setting."""
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    found: dict[str, Any] = {}
    for name, wanted in search.ranges.items():
        if isinstance(wanted, list):
            found[name] = CategoricalDistribution(wanted)
        elif isinstance(wanted.low, int) and isinstance(wanted.high, int):
            found[name] = IntDistribution(wanted.low, wanted.high, log=wanted.log)
        else:
            found[name] = FloatDistribution(float(wanted.low), float(wanted.high), log=wanted.log)
    return found


def _settings(trial: optuna.Trial) -> list[str]:
    return [f"{name}={to_toml_value(value)}" for name, value in trial.params.items()]


def _settings_of(trial: optuna.Trial) -> str:
    return json.dumps(trial.params)
