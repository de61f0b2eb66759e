"""`athrl watch --policy`: drives episodes without a run, and shows them while they are driven."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import count, islice
from pathlib import Path

import rerun as rr
from athrl_protocol.run_file import EnvironmentSection

from athrl_evaluator.drawing import APPLICATION, SceneDrawing, make_blueprint
from athrl_evaluator.errors import EvaluatorError, writing
from athrl_evaluator.evaluate import fitted, make_batch_driver
from athrl_evaluator.recording.frames import frame_of_step
from athrl_evaluator.scoring.drivers import BatchDriver
from athrl_evaluator.scoring.environments import make_batch
from athrl_evaluator.scoring.episodes import EpisodeObserver, EpisodeStep, Stopped, drive_episodes
from athrl_evaluator.watching.browser import tell
from athrl_evaluator.watching.viewer import Server
from athrl_evaluator.watching.watch import viewer_of

POLL_SECONDS = 0.05  # between two checks whether the viewer was closed


class LiveDrawing(EpisodeObserver):
    """Draws each decision at its simulated time.

    Args:
        driver: drives the episodes.
        drawing: draws the frames.
        over: tells whether to stop; called while waiting.
        paced: whether to wait for the simulated time to pass.
        clock: seconds, monotonic.
    """

    def __init__(
        self,
        driver: BatchDriver,
        drawing: SceneDrawing,
        over: Callable[[], bool],
        *,
        paced: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._driver, self._drawing, self._over = driver, drawing, over
        self._paced, self._clock = paced, clock
        self._began = 0.0

    def on_step(self, step: EpisodeStep) -> None:
        """Wait for the time of the step and draw it; raises Stopped when `over` is true."""
        frame = frame_of_step(self._driver, step)
        if step.step == 1:
            self._began = self._clock() - frame.time
        # A late drawing catches up at most one second; a longer delay is not made up.
        self._began = max(self._began, self._clock() - frame.time - 1.0)
        while self._paced and self._clock() < self._began + frame.time:
            if self._over():
                raise Stopped
            time.sleep(min(POLL_SECONDS, max(0.0, self._began + frame.time - self._clock())))
        if self._over():
            raise Stopped
        self._drawing.draw(frame)


def watch_policy(
    driver: Path | str,
    *,
    environment: EnvironmentSection,
    forced: Sequence[str] = (),
    episodes: int | None = None,
    seed: int = 0,
    server: Server | None = None,
    save: Path | None = None,
    stop: threading.Event,
) -> int:
    """Drive one episode after another and show them in real time until stopped or closed.

    Returns:
        The number of episodes that were driven to their end.

    Args:
        driver: a policy file, or one of REFERENCE_DRIVERS by name.
        environment: its settings; a policy drives with the image size and limits that it was trained for.
        forced: decisions of the policy that are forced, each as NAME=VALUE.
        episodes: number of episodes; None: no limit.
        seed: of the first episode; the others have the next ones.
        server: a rerun server listens there, and no window is opened.
        save: write a rerun file instead, as fast as it can be driven.
        stop: ends it.

    Raises:
        InvalidPolicy, CannotForce, RunFileError, EvaluatorError: as `evaluate_driver`.
        EnvironmentFailure: an environment failed.
        ProtocolError: there is no screen, or a port is taken.
    """
    who, environment = fitted(driver, environment, forced)
    batch_driver = make_batch_driver(who, 1, forced=forced)
    with ExitStack() as stack:
        # The viewer first: errors of screen or port are reported before the environments are made.
        if save is not None:
            stream, closed = stack.enter_context(_saved(save)), stop.is_set
        else:
            stream, closed, address = stack.enter_context(viewer_of(server))
            tell(f"watching {Path(driver).stem}", address)
        batch = make_batch(environment, 1, action_kind=batch_driver.action_kind)
        stack.callback(batch.close)
        drawing = LiveDrawing(
            batch_driver, SceneDrawing(stream), lambda: stop.is_set() or closed(), paced=save is None
        )
        driven = 0
        with suppress(Stopped):
            for each in islice(count(seed), episodes):
                drive_episodes(batch_driver, batch, [each], [drawing], stop)
                driven += 1
        return driven


@contextmanager
def _saved(path: Path) -> Iterator[rr.RecordingStream]:
    """A stream that is written into a rerun file, which is there when all of it is."""
    part = path.with_name(f"{path.name}.part")
    if path.is_dir():
        raise EvaluatorError(f"cannot write {path}: is a folder, should be a file")
    with writing(path):
        part.touch()
    stream = rr.RecordingStream(APPLICATION)
    stream.save(part, default_blueprint=make_blueprint())
    try:
        yield stream
        stream.flush()
        stream.disconnect()
        with writing(path):
            part.replace(path)
    finally:
        stream.disconnect()
        part.unlink(missing_ok=True)
