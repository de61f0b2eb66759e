"""`athrl watch`: draw a service's live frames, or a recorded episode, in rerun.

Frames arrive over Zenoh and wait in a short queue; if drawing is slower, the oldest are dropped. So neither a
slow viewer nor one that hangs affects the watched service.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import chain
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
from athrl_evaluator.recording.reading import read_frames
from athrl_evaluator.watching.browser import tell
from athrl_evaluator.watching.viewer import (
    Server,
    free_port,
    require_screen,
    server_process,
    viewer_process,
)

QUEUE = 50  # frames
POLL_SECONDS = 0.2
ACTOR_SECONDS = 10.0  # within which an actor's presence has to be seen


class FrameQueue:
    """The newest frames, oldest first."""

    def __init__(self, length: int) -> None:
        self._frames: deque[Frame] = deque(maxlen=length)
        self._arrived = threading.Event()

    def put(self, frame: Frame) -> None:
        """Add a frame; the oldest is dropped when there are too many. Never waits."""
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
    server: Server | None = None,
    stop: threading.Event | None = None,
) -> None:
    """Draw the frames of the service `role`/`name` until `stop` is set or the viewer is closed.

    Without `server` a viewer is opened; with it a rerun server listens there until the run is over; its
    address is printed. Without `run` the only existing run is watched. Raises ProtocolError when the learner,
    the run or the actor does not exist, or a port is taken.
    """
    if server is None:
        require_screen()  # before waiting for the learner
    stop = stop or threading.Event()
    frames = FrameQueue(QUEUE)
    with ExitStack() as stack:
        patience = NetworkSection().patience
        try:
            session = stack.enter_context(open_session(connect=connect, timeout=patience, stop=stop))
            run_file = fetch_run_file(session, run, timeout=patience, stop=stop)
        except LearnerNotFound:
            if stop.is_set():
                return
            raise
        run = run_file.run.name
        over = _end_detector(session, run, role, name, stack)
        stream, closed, address = stack.enter_context(viewer_of(server))
        stack.enter_context(subscribe_frames(session, run, role, name, frames.put))
        tell(f"watching {role} {name}", address)
        drawing = SceneDrawing(stream, run_file.environment.towns)
        while not stop.is_set() and not closed():
            frame = frames.take(POLL_SECONDS)
            if frame is not None:
                drawing.draw(frame)
            elif server is not None and over():
                print(f"run {run} is over", flush=True)
                return


def watch_recording(recording: Path, *, server: Server | None = None, stop: threading.Event) -> None:
    """Show a recorded episode in a viewer, or on a server, until `stop` is set or it is closed.

    Raises ProtocolError when the file is no recording or the port is taken.
    """
    frames = read_frames(recording)
    first = next(frames)  # what is no recording opens no viewer
    with ExitStack() as stack:
        stream, closed, address = stack.enter_context(viewer_of(server))
        drawing = SceneDrawing(stream)
        for frame in chain([first], frames):
            if stop.is_set():
                return
            drawing.draw(frame)
        tell(f"showing {recording}", address)
        while not closed() and not stop.wait(POLL_SECONDS):
            pass


class Viewer(NamedTuple):
    """A stream that is shown in a viewer or on a server."""

    stream: rr.RecordingStream
    closed: Callable[[], bool]
    """Whether the window was closed or the server has ended."""
    address: str
    """The address for other viewers."""


@contextmanager
def viewer_of(server: Server | None) -> Iterator[Viewer]:
    """A viewer with a window, or with `server` a server without a window that listens there.

    Raises:
        ProtocolError: there is no screen, a port is taken, or the server would be open to other machines.
    """
    where = server or Server(free_port())
    with viewer_process(where.port) if server is None else server_process(where) as process:
        stream = rr.RecordingStream(APPLICATION)
        try:
            stream.connect_grpc(where.address, default_blueprint=make_blueprint())
            yield Viewer(stream, lambda: process.poll() is not None, where.shown_address)
        finally:
            stream.disconnect()


def _end_detector(
    session: zenoh.Session, run: str, role: str, name: str, stack: ExitStack
) -> Callable[[], bool]:
    """Return a function that tells whether the run is finished and the watched service gone.

    Raises RunNotFound for an actor that is not present; an evaluator may join later.
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
