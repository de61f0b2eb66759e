"""Scores drivers on a run's fixed episodes, records them and writes the scores. Uses no network."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

from athrl_driving.policy import OnnxPolicy
from athrl_protocol import EvaluationResult, PolicyUpdate
from athrl_protocol.run_file import RunFile
from athrl_spaces import REFERENCE_DRIVERS

from athrl_evaluator.broadcast import Broadcast
from athrl_evaluator.dashboard import with_interval
from athrl_evaluator.evaluate import make_batch_driver
from athrl_evaluator.event_files import EventFiles
from athrl_evaluator.recording.recorder import Recorder, name_of
from athrl_evaluator.scoring.environments import Environments, town_labels
from athrl_evaluator.scoring.episodes import EpisodeObserver, drive_episodes
from athrl_evaluator.scoring.results import ResultsFolder
from athrl_evaluator.scoring.scores import EpisodeResult, score

ENVIRONMENTS = 8  # stepped together

log = logging.getLogger(__name__)


class Scoring:
    """Drives the run's evaluation episodes; `files` also accepts other curves."""

    def __init__(
        self,
        run_file: RunFile,
        folder: ResultsFolder,
        stack: ExitStack,
        *,
        tell: Callable[[EvaluationResult], object],
        observers: Sequence[EpisodeObserver] = (),
        broadcast: Broadcast | None = None,
    ) -> None:
        """Make environments when they are needed.

        Args:
            run_file: the run's settings.
            folder: where results, recordings and curves go.
            stack: closes the environments.
            tell: called with each result after it has been written.
            observers: notified of every step.
            broadcast: shows the first episode of each driver.
        """
        self._run_file = run_file
        self._settings = run_file.evaluator
        self._folder = folder
        self._tell = tell
        self._observers = list(observers)
        self._broadcast = broadcast
        self.episodes_done = 0
        reserve = round(run_file.durability.reserve_mebibytes * 2**20)
        self.files = EventFiles(folder.tensorboard, folder.warn, reserve_bytes=reserve)
        self._environments = Environments(
            run_file.environment,
            min(ENVIRONMENTS, self._settings.episodes),
            run_file.actor.stall_seconds,
        )
        self._labels = town_labels(self._environments.towns)
        stack.callback(self._environments.close)

    def score_policy(
        self, update: PolicyUpdate, *, recorded: bool = True, stop: threading.Event | None = None
    ) -> EvaluationResult:
        """Score a policy on the few episodes in each town for which there is time during training.

        Raises:
            InvalidPolicy: it cannot be run.
            EnvironmentFailure: an environment raised or stalled; the next call has new environments.
            Stopped: `stop` was set before the last episode was over.
        """
        episodes = self._settings.episodes
        scores = self._drive(OnnxPolicy(update.artefact), update, episodes, episodes * recorded, stop)
        return self._take_result("policy", update, scores)

    def compare(self, update: PolicyUpdate, stop: threading.Event | None = None) -> None:
        """Score the last policy and the reference drivers on the same episodes, and write the comparison.

        Scores in several towns are given over all towns, and for each town as `town/score`.

        Raises as `score_policy` does.
        """
        drivers: list[OnnxPolicy | str] = [OnnxPolicy(update.artefact), *REFERENCE_DRIVERS]
        recorded = max(1, self._settings.recordings_kept // (len(drivers) * len(self._labels)))
        results = []
        for driver in drivers:
            scores = self._drive(driver, update, self._settings.final_episodes, recorded, stop)
            name = driver if isinstance(driver, str) else "policy"
            results.append(self._take_result(name, update, scores))
        self._folder.write_comparison(self._run_file.run.name, results)

    def _drive(
        self,
        driver: OnnxPolicy | str,
        update: PolicyUpdate,
        episodes: int,
        recorded: int,
        stop: threading.Event | None,
    ) -> dict[str, float]:
        """Drive so many episodes in each town; the scores."""
        results = {
            label: self._drive_in(town, driver, update, episodes, recorded, stop)
            for town, label in self._labels.items()
        }
        scores = score([result for in_town in results.values() for result in in_town]).as_dict()
        if len(results) > 1:
            for label, in_town in results.items():
                scores |= {f"{label}/{name}": value for name, value in score(in_town).as_dict().items()}
        return scores

    def _drive_in(
        self,
        town: str,
        driver: OnnxPolicy | str,
        update: PolicyUpdate,
        episodes: int,
        recorded: int,
        stop: threading.Event | None,
    ) -> list[EpisodeResult]:
        version = update.version if isinstance(driver, OnnxPolicy) else 0
        batch_driver = make_batch_driver(driver, min(ENVIRONMENTS, self._settings.episodes), version)
        batch = self._environments.batch(town, batch_driver.action_kind)
        name = name_of(batch_driver)
        recorder = Recorder(
            batch_driver,
            self._folder.recordings,
            episodes=recorded,
            kept=self._settings.recordings_kept,
            broadcast=self._broadcast,
            named=name if len(self._labels) == 1 else f"{name}-{self._labels[town]}",
            warn=self._folder.warn,
        )
        seeds = range(self._settings.seed, self._settings.seed + episodes)
        try:
            results = drive_episodes(batch_driver, batch, seeds, [recorder, *self._observers], stop)
        finally:
            recorder.close()
        self.episodes_done += len(results)
        return results

    def _take_result(self, driver: str, update: PolicyUpdate, scores: dict[str, float]) -> EvaluationResult:
        """Write a driver's scores, then call `tell`."""
        towns = list(self._labels)
        result = EvaluationResult(
            driver=driver,
            policy_version=update.version if driver == "policy" else 0,
            environment_steps=update.environment_steps,
            town=towns[0] if len(towns) == 1 else f"{len(towns)} towns",
            seed=self._settings.seed,
            scores=scores,
        )
        self._folder.add(result)
        steps, now = update.environment_steps, time.time()
        self.files.add(f"evaluation/{driver}", with_interval(result.scores), steps, now)
        self.files.add_links(self._folder.recordings, steps, now)
        self._tell(result)
        name = f"policy {update.version}" if driver == "policy" else driver
        log.info("%s: return %.0f ± %.0f", name, scores["return_mean"], scores["return_ci95"])
        return result
