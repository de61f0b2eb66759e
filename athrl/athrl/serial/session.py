"""A serial run from its folder's lock to its closing comparison."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import torch
from athrl_evaluator.episodes import Stopped
from athrl_evaluator.results import ResultsFolder
from athrl_evaluator.scoring import Scoring
from athrl_learner import CannotResume
from athrl_learner.checkpoint import CheckpointContent
from athrl_learner.device import log_device
from athrl_learner.going_on import checkpoint_to_go_on_from
from athrl_learner.memory import keep_freed_memory
from athrl_learner.parts import make_parts
from athrl_learner.run import short_collections
from athrl_learner.run_folder import RunFolder
from athrl_protocol import EvaluationResult
from athrl_protocol.run_file import RunFile, to_toml

from athrl.runs import run_folder
from athrl.serial.actor import SerialActor
from athrl.serial.rounds import Observers, SerialRun
from athrl.serial.trace import Trace, cut_back, size_of
from athrl.serial.view import SerialView
from athrl.train.display import Display

log = logging.getLogger(__name__)


def run_serial(
    settings: RunFile,
    *,
    resume: bool,
    stop: threading.Event,
    stop_at: int | None = None,
    display: Display | None = None,
) -> bool:
    """Start a run, or go on with one, until it is finished and compared; whether it is.

    Calls `torch.use_deterministic_algorithms` and `torch.set_num_threads` for the whole process.

    Args:
        settings: of the run.
        resume: whether the run's folder holds it already.
        stop: set from a signal handler or another thread; the round is finished and a checkpoint written.
        stop_at: environment steps of the whole run after which to stop in the same way.
        display: shows how the run goes.

    Raises:
        LearnerError: the folder is taken, in use, or cannot be resumed, the disk does not take the run, or
            this machine has not the device that the settings ask for.
    """
    log_device(settings)
    _make_torch_deterministic(settings)
    with ExitStack() as stack:
        folder = stack.enter_context(RunFolder(run_folder(settings)))
        content = checkpoint_to_go_on_from(folder, resuming=resume, serial=True)
        stack.enter_context(_log_in(folder.path / "logs" / "serial.log"))
        session = SerialSession(settings, folder, content, stack, display)
        stack.enter_context(short_collections())
        return session.run(stop, stop_at)


class SerialSession:
    """The parts of a serial run, put together."""

    def __init__(
        self,
        settings: RunFile,
        folder: RunFolder,
        content: CheckpointContent | None,
        stack: ExitStack,
        display: Display | None,
    ) -> None:
        """Make the parts, from `content` if there is any; what must be closed is put on `stack`.

        Raises:
            CannotResume: `content` does not fit the settings, or an environment does not come back.
        """
        self._actor = SerialActor(settings, stack)
        self._parts = make_parts(
            stack, settings, folder, content, self._actor.adopt, after_the_checkpoint="driven again"
        )
        if content is not None:
            self._go_on(content)
        results = ResultsFolder(folder.path.parent, folder.path.name)
        self._files = {"trace": folder.path / "trace.txt", "evaluations": folder.path / "evaluations.jsonl"}
        self._cut_back(content)
        folder.lay_out(to_toml(settings))
        self._scoring = Scoring(settings, results, stack, tell=self._heard)
        self._view = SerialView(settings, folder.path, self._parts, self._actor, self._scoring.files, display)
        self._run = SerialRun(
            settings, self._parts, self._actor, Trace(self._files["trace"]), self._observers()
        )
        if content is None:
            self._run.begin()

    def run(self, stop: threading.Event, stop_at: int | None) -> bool:
        """Go through the run and its closing comparison; whether it came to its end."""
        if not self._run.run(stop, stop_at):
            return False
        self._view.finished()
        try:
            self._scoring.compare(self._actor.policy, stop)
        except Stopped:
            log.info("stopped in the closing comparison")
            return False
        return True

    def _go_on(self, content: CheckpointContent) -> None:
        assert content.actor is not None
        try:
            self._actor.resume(content.actor)
        except (KeyError, TypeError, ValueError) as error:
            raise CannotResume(
                f"the checkpoint's actor does not fit the run's settings; was one overridden? {error}"
            ) from None
        self._parts.publication.go_on(content.policy_version)
        self._parts.publication.noise_scale = self._actor.policy.noise_scale

    def _cut_back(self, content: CheckpointContent | None) -> None:
        """Forget what a killed run wrote behind the checkpoint: it happens again, and is the same."""
        noted = content.actor["files"] if content is not None and content.actor is not None else {}
        for name, path in self._files.items():
            cut_back(path, int(noted.get(name, 0)))
        removed = self._parts.store.log.remove_later()
        if removed:
            log.info("%d segments of the log came after the checkpoint; they are driven again", removed)

    def _observers(self) -> Observers:
        return Observers(
            score=lambda: self._scoring.score_policy(self._actor.policy, recorded=False),
            report=self._view.report,
            look=self._view.look,
            files=lambda: {name: size_of(path) for name, path in self._files.items()},
        )

    def _heard(self, result: EvaluationResult) -> None:
        self._view.heard(result)
        if result.driver == "policy":
            self._parts.best.heard(result.policy_version, result.scores["return_mean"])


def _make_torch_deterministic(settings: RunFile) -> None:
    # Both are read when the libraries are first used: sums in one order, whatever the memory's alignment.
    os.environ.setdefault("MKL_CBWR", "AUTO")
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.use_deterministic_algorithms(True)
    # By itself one thread: with another number sums come out otherwise, and the machine shall not matter.
    keep_freed_memory()


@contextmanager
def _log_in(path: Path) -> Iterator[None]:
    """Have the process's log in a file of the run's folder for a while, instead of where it was."""
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
