"""Show the newest first episode to whoever watches, near real time, without holding up the evaluation.

An episode is driven in a fraction of the time that it simulates. So the frames of the first episode of each
evaluation are kept, and a thread of its own plays them while somebody watches; the newest episode is played
again until there is a newer one.
"""

from __future__ import annotations

import logging
import threading
from typing import Protocol

from athrl_protocol import Frame
from athrl_protocol.background import Background

LONGEST_PAUSE = 1.0  # s between two frames, whatever their simulated times are
PAUSE_BETWEEN = 1.0  # s between two episodes
IDLE = 0.2  # s between two looks whether somebody watches

log = logging.getLogger(__name__)


class FrameSink(Protocol):
    """What the frames are given to."""

    @property
    def watched(self) -> bool:
        """Whether somebody watches."""

    def publish(self, frame: Frame) -> None:
        """Send one frame."""


class Broadcast:
    """Plays the newest episode while somebody watches."""

    def __init__(self, sink: FrameSink) -> None:
        self._sink = sink
        self._newest: list[Frame] = []
        self._background = Background("showing an episode", log)
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, name="broadcast", daemon=True)
        self._thread.start()

    def show(self, frames: list[Frame]) -> None:
        """A new episode; it is played when the present one is over."""
        with self._lock:
            self._newest = frames

    def close(self) -> None:
        """Stop playing."""
        self._stop.set()
        self._thread.join(timeout=5)

    def _play(self) -> None:
        while not self._stop.wait(IDLE):
            with self._lock:
                frames = self._newest
            if frames and self._sink.watched:
                with self._background.watched():  # the next episode may go better
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
