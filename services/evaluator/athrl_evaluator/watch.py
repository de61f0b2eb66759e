"""`athrl watch`: draw a service's live frames, or a recorded episode, in rerun.

Frames come over Zenoh and wait in a short queue; when drawing is slower than they come, the oldest go.
So neither a slow viewer nor one that hangs is felt by the service that is watched.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import rerun as rr
import zenoh
from athrl_protocol import (
    Frame,
    LearnerNotFound,
    Phase,
    PresenceWatcher,
    RunNotFound,
    StateSubscriber,
    fetch_run_file,
    open_session,
    subscribe_frames,
)
from athrl_protocol.run_file import NetworkSection

from athrl_evaluator.drawing import APPLICATION, SceneDrawing, make_blueprint
from athrl_evaluator.recording_drawing import read_frames
from athrl_evaluator.viewer import free_port, proxy_address, require_screen, server_process, viewer_process

QUEUE = 50  # frames
POLL_SECONDS = 0.2
ACTOR_SECONDS = 10.0  # within which an actor has to show that it is there


class FrameQueue:
    """The newest frames, oldest first."""

    def __init__(self, length: int) -> None:
        self._frames: deque[Frame] = deque(maxlen=length)
        self._arrived = threading.Event()

    def put(self, frame: Frame) -> None:
        """Add a frame; the oldest goes when there are too many. Never waits."""
        self._frames.append(frame)
        self._arrived.set()

    def take(self, timeout: float) -> Frame | None:
        """The oldest frame; None if there is none within `timeout` seconds."""
        if not self._frames:
            self._arrived.clear()
            if not self._frames and not self._arrived.wait(timeout):
                return None
        return self._frames.popleft() if self._frames else None


def watch(
    *,
    connect: str,
    run: str | None,
    role: str = "evaluator",
    name: str = "evaluator",
    serve: int | None = None,
    bind: str = "127.0.0.1",
    stop: threading.Event | None = None,
) -> None:
    """Draw the frames of the service `role`/`name` until `stop` is set or the viewer is closed.

    Without `serve` a viewer is opened; with it a rerun server listens at `bind` and that port until the run
    is over; its address is printed. Without `run` it is the only one that is there. Raises ProtocolError
    when the learner, the run or the actor is not there, or the port is taken.
    """
    if serve is None:
        require_screen()  # before anybody is waited for
    stop = stop or threading.Event()
    frames = FrameQueue(QUEUE)
    with ExitStack() as stack:
        patience = NetworkSection().patience
        try:
            session = stack.enter_context(open_session(connect=connect, timeout=patience, stop=stop))
        except LearnerNotFound:
            if stop.is_set():
                return
            raise
        run = fetch_run_file(session, run, timeout=patience, stop=stop).run.name
        over = _over_when_gone(session, run, role, name, stack)
        stream, closed, address = stack.enter_context(viewer_of(serve, bind))
        stack.enter_context(subscribe_frames(session, run, role, name, frames.put))
        print(f"watching {role} {name}: {address}", flush=True)
        drawing = SceneDrawing(stream)
        while not stop.is_set() and not closed():
            frame = frames.take(POLL_SECONDS)
            if frame is not None:
                drawing.draw(frame)
            elif serve is not None and over():
                print(f"run {run} is over", flush=True)
                return


def watch_recording(
    recording: Path, *, serve: int | None, bind: str = "127.0.0.1", stop: threading.Event
) -> None:
    """Show a recorded episode in a viewer, or on a server, until `stop` is set or that is closed.

    Raises ProtocolError when the file is no recording or the port is taken.
    """
    frames = list(takewhile(lambda _: not stop.is_set(), read_frames(recording)))
    if stop.is_set():
        return
    with ExitStack() as stack:
        stream, closed, address = stack.enter_context(viewer_of(serve, bind))
        drawing = SceneDrawing(stream)
        for frame in frames:
            if stop.is_set():
                return
            drawing.draw(frame)
        print(f"showing {recording}: {address}", flush=True)
        while not closed() and not stop.wait(POLL_SECONDS):
            pass


class Viewer(NamedTuple):
    """A stream that somebody sees."""

    stream: rr.RecordingStream
    closed: Callable[[], bool]
    """Whether the window was closed, or the server is gone."""
    address: str
    """What other viewers connect to."""


@contextmanager
def viewer_of(serve: int | None, bind: str = "127.0.0.1") -> Iterator[Viewer]:
    """A viewer with a window, or with `serve` a server without one that listens at `bind` and this port.

    Raises:
        ProtocolError: there is no screen, or the port is taken.
    """
    port = free_port() if serve is None else serve
    bind = "127.0.0.1" if serve is None else bind
    address = proxy_address(bind, port)
    with viewer_process(port) if serve is None else server_process(bind, port) as process:
        stream = rr.RecordingStream(APPLICATION)
        try:
            stream.connect_grpc(address, default_blueprint=make_blueprint())
            yield Viewer(stream, lambda: process.poll() is not None, address)
        finally:
            stream.disconnect()


def _over_when_gone(
    session: zenoh.Session, run: str, role: str, name: str, stack: ExitStack
) -> Callable[[], bool]:
    """Return what tells whether the run is finished and the watched service gone.

    Raises RunNotFound if it is an actor that is not there; the evaluator may come later.
    """
    presence = stack.enter_context(PresenceWatcher(session, run))
    state = stack.enter_context(StateSubscriber(session, run))
    if role == "actor" and not presence.wait_for(lambda present: (role, name) in present, ACTOR_SECONDS):
        others = ", ".join(sorted(other for kind, other in presence.present() if kind == role)) or "none"
        raise RunNotFound(f"run {run!r} has no {role} {name!r}; it has {others}")

    def over() -> bool:
        newest = state.newest()
        finished = newest is not None and newest.phase is Phase.FINISHED
        return finished and (role, name) not in presence.present()

    return over
