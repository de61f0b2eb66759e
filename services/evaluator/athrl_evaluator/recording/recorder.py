"""Records the episodes of an evaluation while they are driven, and gives the first one to the broadcast."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from athrl_protocol import Frame

from athrl_evaluator.broadcast import Broadcast
from athrl_evaluator.errors import EvaluatorError
from athrl_evaluator.recording.frames import frame_of_step
from athrl_evaluator.recording.origin import Origin
from athrl_evaluator.recording.recordings import EpisodeRecording, prune_recordings
from athrl_evaluator.scoring.drivers import BatchDriver
from athrl_evaluator.scoring.episodes import EpisodeObserver, EpisodeStep
from athrl_evaluator.scoring.scores import EpisodeResult

log = logging.getLogger(__name__)


class Recorder(EpisodeObserver):
    """Records the first `episodes` episodes, one file each, and broadcasts the first one."""

    def __init__(
        self,
        driver: BatchDriver,
        folder: Path,
        *,
        episodes: int,
        kept: int | None,
        needed: bool = False,
        broadcast: Broadcast | None = None,
        named: str | None = None,
        policy: str = "",
        warn: Callable[[str], object] = log.warning,
    ) -> None:
        """Name files after the driver (a policy with its version), or `named`, and the seed.

        `policy` is the name of the policy's file, which the recordings tell.

        `kept` is the most recordings that the folder holds, including earlier evaluations; None: all.

        If the recordings cannot be written, they are given up and `warn` is called with a text, or, if they
        are `needed`, EvaluatorError ends the evaluation.
        """
        self._driver = driver
        self._folder = folder
        self._episodes = episodes
        self._kept = kept
        self._needed = needed
        self._broadcast = broadcast
        self._named = named or name_of(driver)
        self._policy = policy
        self._warn = warn
        self._gave_up = False
        self._open: dict[int, EpisodeRecording] = {}
        self._first_episode: list[Frame] = []

    def on_step(self, step: EpisodeStep) -> None:
        """Write a frame."""
        if step.index >= self._episodes:
            return
        frame = frame_of_step(self._driver, step)
        if step.index == 0:
            self._first_episode.append(frame)
        if self._gave_up:
            return
        with self._given_up_on_write_error():
            if step.index not in self._open:
                self._open[step.index] = EpisodeRecording(
                    recording_path(self._folder, self._named, step.seed),
                    Origin.of(step.environment, step.seed, self._policy),
                )
            self._open[step.index].write(frame, step.action)

    def on_end(self, index: int, result: EpisodeResult) -> None:
        """Complete the episode's file."""
        if index == 0 and self._first_episode and self._broadcast is not None:
            self._broadcast.show(self._first_episode)
        if index not in self._open:
            return
        with self._given_up_on_write_error():
            self._open[index].finish()
            del self._open[index]
            if self._kept is not None:
                prune_recordings(self._folder, self._kept)

    def close(self) -> None:
        """Discard the recordings of unfinished episodes."""
        for recording in self._open.values():
            recording.abandon()
        self._open.clear()

    @contextmanager
    def _given_up_on_write_error(self) -> Iterator[None]:
        try:
            yield
        except EvaluatorError as error:
            if self._needed:
                raise
            self._warn(f"{error}; this evaluation is not recorded any more")
            self.close()
            self._gave_up = True


def recording_path(folder: Path, named: str, seed: int) -> Path:
    """The file of an episode's recording."""
    return folder / f"{named}-seed-{seed}.mcap"


def name_of(driver: BatchDriver) -> str:
    """The name of a driver's recordings: the driver, with the version of a policy."""
    return f"policy-{driver.policy_version:06d}" if driver.name == "policy" else driver.name
