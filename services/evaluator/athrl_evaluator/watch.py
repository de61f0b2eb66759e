"""`athrl watch`: draw a service's live frames in rerun.

Frames come over Zenoh and wait in a short queue; when drawing is slower than they come, the oldest go.
So neither a slow viewer nor one that hangs is felt by the service that is watched.
"""

from __future__ import annotations

import threading
from collections import deque
from contextlib import ExitStack

import rerun as rr
from athrl_protocol import Frame, LearnerNotFound, fetch_run_file, open_session, subscribe_frames
from athrl_protocol.run_file import NetworkSection

from athrl_evaluator.drawing import APPLICATION, SceneDrawing, default_blueprint
from athrl_evaluator.viewer import free_port, proxy_address, server_process, viewer_process

QUEUE = 50  # frames
POLL_SECONDS = 0.2


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
    run: str,
    role: str = "evaluator",
    name: str = "evaluator",
    serve: int | None = None,
    bind: str = "127.0.0.1",
    stop: threading.Event | None = None,
) -> None:
    """Draw the frames of the service `role`/`name` until `stop` is set or the viewer is closed.

    Without `serve` a viewer is opened; with it a rerun server listens at `bind` and that port; its address is
    printed. Raises ProtocolError when the learner or the run is not there, or the port is taken.
    """
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
        fetch_run_file(
            session, run, timeout=patience, stop=stop
        )  # so that a wrong name is an error, not silence
        port = free_port() if serve is None else serve
        bind = "127.0.0.1" if serve is None else bind
        process = stack.enter_context(viewer_process(port) if serve is None else server_process(bind, port))
        stream = rr.RecordingStream(APPLICATION)
        stack.callback(stream.disconnect)
        stream.connect_grpc(proxy_address(bind, port), default_blueprint=default_blueprint())
        stack.enter_context(subscribe_frames(session, run, role, name, frames.put))
        print(f"watching {role} {name}: {proxy_address(bind, port)}", flush=True)
        drawing = SceneDrawing(stream)
        while not stop.is_set() and process.poll() is None:
            frame = frames.take(POLL_SECONDS)
            if frame is not None:
                drawing.draw(frame)
