"""`athrl watch --policy`: drive episodes without any run, and show them while they are driven."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import count, islice
from pathlib import Path

import rerun as rr
from athrl_driving.policy import OnnxPolicy
from athrl_protocol.run_file import EnvironmentSection

from athrl_evaluator.drawing import APPLICATION, SceneDrawing, make_blueprint
from athrl_evaluator.drivers import REFERENCE_DRIVERS, BatchDriver
from athrl_evaluator.environments import environment_for, make_batch, require_fitting
from athrl_evaluator.episodes import EpisodeStep, Onlooker, Stopped, drive_episodes
from athrl_evaluator.errors import EvaluatorError, writing
from athrl_evaluator.evaluate import make_batch_driver
from athrl_evaluator.frames import frame_of_step
from athrl_evaluator.policy_files import load_policy
from athrl_evaluator.watch import viewer_of

GLANCE_SECONDS = 0.05  # between two looks whether the viewer was closed


class LiveDrawing(Onlooker):
    """Draws each decision at the time at which it would be made on the road.

    Args:
        driver: who drives.
        drawing: where it is drawn.
        over: tells whether to stop; looked at while waiting.
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
        """Wait for the moment, and draw it; raises Stopped when it is over."""
        frame = frame_of_step(self._driver, step)
        if step.step == 1:
            self._began = self._clock() - frame.time
        # A drawing that is late catches up with one second at most; what is lost beyond that is lost.
        self._began = max(self._began, self._clock() - frame.time - 1.0)
        while self._paced and self._clock() < self._began + frame.time:
            if self._over():
                raise Stopped
            time.sleep(min(GLANCE_SECONDS, max(0.0, self._began + frame.time - self._clock())))
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
    serve: int | None = None,
    bind: str = "127.0.0.1",
    save: Path | None = None,
    stop: threading.Event,
) -> None:
    """Drive one episode after the other and show them, in real time, until it is stopped or closed.

    Args:
        driver: a policy file, or one of REFERENCE_DRIVERS by name.
        environment: where it drives; a policy has the image size and limits that it was trained for.
        forced: decisions of the policy that are forced, each as NAME=VALUE.
        episodes: after so many it ends; None: never by itself.
        seed: of the first episode; the others have those after it.
        serve: a rerun server listens at this port, and no window is opened.
        bind: address at which that server listens.
        save: write a rerun file instead, as fast as it can be driven.
        stop: ends it.

    Raises:
        InvalidPolicy, CannotForce, RunFileError, EvaluatorError: as `evaluate_driver`.
        EnvironmentFailure: an environment failed.
        ProtocolError: there is no screen, or the port is taken.
    """
    policy: OnnxPolicy | str = str(driver) if driver in REFERENCE_DRIVERS else load_policy(Path(driver))
    if isinstance(policy, OnnxPolicy):
        require_fitting(policy.description, environment)
        environment = environment_for(policy.description, environment)
    elif forced:
        raise EvaluatorError(f"--force {forced[0]}: {driver} is no policy, nothing can be forced on it")
    drives = make_batch_driver(policy, 1, forced=forced)
    with ExitStack() as stack:
        # The viewer first: what is wrong with screen or port is told before the environments are made.
        if save is not None:
            stream, closed = stack.enter_context(_saved(save)), stop.is_set
        else:
            stream, closed, address = stack.enter_context(viewer_of(serve, bind))
            print(f"watching {Path(driver).stem}: {address}", flush=True)
        batch = make_batch(environment, 1, action_kind=drives.action_kind)
        stack.callback(batch.close)
        looking = LiveDrawing(
            drives, SceneDrawing(stream), lambda: stop.is_set() or closed(), paced=save is None
        )
        try:
            for each in islice(count(seed), episodes):
                drive_episodes(drives, batch, [each], [looking], stop)
        except Stopped:
            pass


@contextmanager
def _saved(path: Path) -> Iterator[rr.RecordingStream]:
    """A stream that is written into a rerun file."""
    with writing(path):
        path.touch()
    stream = rr.RecordingStream(APPLICATION)
    stream.save(path, default_blueprint=make_blueprint())
    try:
        yield stream
        stream.flush()
    finally:
        stream.disconnect()
