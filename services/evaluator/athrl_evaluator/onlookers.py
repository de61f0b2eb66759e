"""Those who look on while episodes are driven: the recorder and the broadcast."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from athrl_protocol import Frame

from athrl_evaluator.broadcast import Broadcast
from athrl_evaluator.drivers import BatchDriver
from athrl_evaluator.episodes import EpisodeStep, Onlooker
from athrl_evaluator.errors import EvaluatorError
from athrl_evaluator.frames import frame_of_step
from athrl_evaluator.recordings import EpisodeRecording, prune_recordings
from athrl_evaluator.scores import EpisodeResult

log = logging.getLogger(__name__)


class Recorder(Onlooker):
    """Records the first `episodes` episodes, one file each, and shows the first one."""

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
    ) -> None:
        """Files are named after the driver, a policy with its version, or as `named`, and after the seed.

        `kept` is how many recordings, also of earlier evaluations, the folder holds at most; None: all.

        Where the disk does not take the recordings, they are given up with a warning, or, if they are
        `needed`, EvaluatorError ends the evaluation.
        """
        self._driver = driver
        self._folder = folder
        self._episodes = episodes
        self._kept = kept
        self._needed = needed
        self._broadcast = broadcast
        self._named = named or name_of(driver)
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
        with self._given_up_where_the_disk_is_full():
            if step.index not in self._open:
                self._open[step.index] = EpisodeRecording(
                    self._folder / f"{self._named}-seed-{step.seed}.mcap"
                )
            self._open[step.index].write(frame)

    def on_end(self, index: int, result: EpisodeResult) -> None:
        """Complete the episode's file."""
        if index == 0 and self._first_episode and self._broadcast is not None:
            self._broadcast.show(self._first_episode)
        if index not in self._open:
            return
        with self._given_up_where_the_disk_is_full():
            self._open[index].finish()
            del self._open[index]
        if self._kept is not None:
            prune_recordings(self._folder, self._kept)

    def close(self) -> None:
        """Give up the episodes that are not over."""
        for recording in self._open.values():
            recording.abandon()
        self._open.clear()

    @contextmanager
    def _given_up_where_the_disk_is_full(self) -> Iterator[None]:
        try:
            yield
        except EvaluatorError as error:
            if self._needed:
                raise
            log.warning("%s; this evaluation is not recorded any more", error)
            self.close()
            self._gave_up = True


def name_of(driver: BatchDriver) -> str:
    """What recordings of a driver are named after: it, and a policy's version."""
    return f"policy-{driver.policy_version:06d}" if driver.name == "policy" else driver.name
