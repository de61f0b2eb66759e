"""A serial run, from locking its folder to its closing comparison."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import torch
from athrl_driving.policy import EnvironmentFailure
from athrl_evaluator.scorer import Scoring
from athrl_evaluator.scoring.episodes import Stopped
from athrl_evaluator.scoring.results import ResultsFolder
from athrl_learner import CannotResume
from athrl_learner.checkpoint import CheckpointContent
from athrl_learner.checkpoint.resume import checkpoint_to_resume
from athrl_learner.components import make_components
from athrl_learner.log import count_of
from athrl_learner.run import frozen_garbage_collector
from athrl_learner.run_changes import replace_settings
from athrl_learner.run_folder import RunFolder
from athrl_learner.training.device import log_device
from athrl_learner.training.memory import keep_freed_memory
from athrl_protocol import EvaluationResult
from athrl_protocol.run_file import RunFile, with_whole_maps
from athrl_spaces.untrusted import parser_errors
from athrl_spaces.wording import counted

from athrl.display import Display
from athrl.runs import run_folder
from athrl.serial.actor import SerialActor
from athrl.serial.rounds import Observers, SerialRun
from athrl.serial.trace import Trace, size_of, truncate_to
from athrl.serial.view import SerialView

log = logging.getLogger(__name__)


def run_serial(
    settings: RunFile,
    *,
    resume: bool,
    stop: threading.Event,
    stop_at: int | None = None,
    display: Display | None = None,
) -> bool:
    """Start or resume a run, until it is finished and compared; return whether it is.

    Calls `torch.set_deterministic_debug_mode` and `torch.set_num_threads` for the whole process.

    Args:
        settings: settings of the run.
        resume: whether the folder already holds the run.
        stop: set from a signal handler or another thread; the round is finished and a checkpoint written.
        stop_at: total environment steps after which to stop in the same way.
        display: shows the progress.

    Raises:
        LearnerError: the folder is taken, in use, or cannot be resumed, it cannot be written, or this machine
            does not have the device in the settings.
        RunFileError: a map is missing or is another one.
    """
    settings = with_whole_maps(settings)
    log_device(settings)
    keep_freed_memory()
    _make_torch_deterministic()
    with ExitStack() as stack:
        folder = stack.enter_context(RunFolder(run_folder(settings)))
        content = checkpoint_to_resume(folder, resuming=resume, serial=True)
        stack.enter_context(_log_in(folder.path / "logs" / "serial.log"))
        session = SerialSession(settings, folder, content, stack, display)
        stack.enter_context(frozen_garbage_collector())
        return session.run(stop, stop_at)


class SerialSession:
    """The components of a serial run, put together."""

    def __init__(
        self,
        settings: RunFile,
        folder: RunFolder,
        content: CheckpointContent | None,
        stack: ExitStack,
        display: Display | None,
    ) -> None:
        """Make the components, from `content` if given; everything that must be closed is put on `stack`.

        Raises:
            CannotResume: `content` does not fit the settings, or an environment cannot be restored.
        """
        self._actor = SerialActor(settings, stack)
        self._components = make_components(
            stack, settings, folder, content, self._actor.set_policy, later_experience="repeated"
        )
        if content is not None:
            self._resume(content)
        results = ResultsFolder(folder.path.parent, folder.path.name)
        self._files = {"trace": folder.path / "trace.txt", "evaluations": folder.path / "evaluations.jsonl"}
        self._truncate_to_checkpoint(content)
        changes = replace_settings(folder, settings, self._components.store.environment_steps)
        self._scoring = Scoring(settings, results, stack, tell=self._note_result)
        self._view = SerialView(
            settings, folder.path, self._components, self._actor, self._scoring.files, display, changes
        )
        self._run = SerialRun(
            settings, self._components, self._actor, Trace(self._files["trace"]), self._observers()
        )
        if content is None:
            self._run.begin()

    def run(self, stop: threading.Event, stop_at: int | None) -> bool:
        """Run to the end, including the closing comparison; return whether the end was reached."""
        if not self._run.run(stop, stop_at):
            return False
        self._view.finished()
        try:
            self._scoring.compare(self._actor.policy, stop)
        except Stopped:
            log.info("stopped in the closing comparison")
            return False
        return True

    def _resume(self, content: CheckpointContent) -> None:
        assert content.actor is not None
        with parser_errors(_does_not_fit, RuntimeError):
            self._actor.resume(content.actor)
        self._components.publication.resume_from(content.policy_version)
        self._components.publication.noise_scale = self._actor.policy.noise_scale

    def _truncate_to_checkpoint(self, content: CheckpointContent | None) -> None:
        """Remove what a killed run wrote after the checkpoint: it will be repeated identically."""
        with parser_errors(_does_not_fit):
            noted = content.actor["files"] if content is not None and content.actor is not None else {}
            sizes = {path: count_of(noted.get(name, 0)) for name, path in self._files.items()}
        for path, size in sizes.items():
            truncate_to(path, size)
        removed = self._components.store.log.remove_later_segments()
        if removed:
            log.info(
                "removed %s of the log after the checkpoint, to be repeated", counted(removed, "segment")
            )

    def _observers(self) -> Observers:
        return Observers(
            score=self._score,
            report=self._view.report,
            refresh=self._view.refresh,
            files=lambda: {name: size_of(path) for name, path in self._files.items()},
        )

    def _score(self) -> None:
        """Score the newest policy; a failure costs that score, and not the run, which does not need it."""
        update = self._actor.policy
        try:
            self._scoring.score_policy(update, recorded=False)
        except EnvironmentFailure as failure:
            log.warning("policy %d was not scored: %s", update.version, failure)

    def _note_result(self, result: EvaluationResult) -> None:
        self._view.note_result(result)
        if result.driver == "policy":
            self._components.best.add_score(result.policy_version, result.scores["return_mean"])


def _does_not_fit(reason: str) -> CannotResume:
    return CannotResume(
        f"the checkpoint's actor does not fit the run's settings; was one overridden? {reason}"
    )


def _make_torch_deterministic() -> None:
    # Both are read at the first use of the libraries: the order of sums must not depend on alignment.
    os.environ.setdefault("MKL_CBWR", "AUTO")
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    # As use_deterministic_algorithms does, which also loads torch's compiler: four seconds of a core.
    torch.set_deterministic_debug_mode("error")


@contextmanager
def _log_in(path: Path) -> Iterator[None]:
    """Write the process's log to a file in the run's folder within the context."""
    path.parent.mkdir(parents=True, exist_ok=True)
    root = logging.getLogger()
    before = root.handlers[:]
    handler = logging.FileHandler(path)
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s %(message)s"))
    root.handlers = [handler]
    try:
        yield
    finally:
        root.handlers = before
        handler.close()
