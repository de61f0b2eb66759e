"""Plays the newest first episode to viewers, in near real time, without delaying the evaluation.

An episode is driven in a fraction of its simulated time. So the frames of the first episode of each
evaluation are kept, and a separate thread plays them while they are watched; the newest episode is repeated
until there is a newer one.
"""

from __future__ import annotations

import logging
import threading
from typing import Protocol

from athrl_protocol import Frame
from athrl_protocol.faults.background import Background

LONGEST_PAUSE = 1.0  # s between two frames at most
PAUSE_BETWEEN = 1.0  # s between two episodes
POLL_SECONDS = 0.2  # s between two checks for viewers

log = logging.getLogger(__name__)


class FrameSink(Protocol):
    """The receiver of the frames."""

    @property
    def watched(self) -> bool:
        """Whether there is a viewer."""

    def publish(self, frame: Frame) -> None:
        """Send one frame."""


class Broadcast:
    """Plays the newest episode while it is watched."""

    def __init__(self, sink: FrameSink) -> None:
        self._sink = sink
        self._newest: list[Frame] = []
        self._background = Background("showing an episode", log)
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, name="broadcast", daemon=True)
        self._thread.start()

    def show(self, frames: list[Frame]) -> None:
        """Set a new episode; it is played when the present one is over."""
        with self._lock:
            self._newest = frames

    def close(self) -> None:
        """Stop playing."""
        self._stop.set()
        self._thread.join(timeout=5)

    def _play(self) -> None:
        while not self._stop.wait(POLL_SECONDS):
            with self._lock:
                frames = self._newest
            if frames and self._sink.watched:
                with self._background.watched():  # the next episode may succeed
                    self._play_episode(frames)
                self._stop.wait(PAUSE_BETWEEN)

    def _play_episode(self, frames: list[Frame]) -> None:
        before = frames[0].time
        for frame in frames:
            pause = min(max(0.0, frame.time - before), LONGEST_PAUSE)
            if self._stop.wait(pause) or not self._sink.watched:
                return
            self._sink.publish(frame)
            before = frame.time
