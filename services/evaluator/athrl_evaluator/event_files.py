"""TensorBoard event files of everybody's metrics and of the evaluations, without torch or TensorFlow."""

from __future__ import annotations

import io
import logging
import math
import os
import socket
import threading
import time
from collections.abc import Mapping
from pathlib import Path

from tensorboard.compat.proto.event_pb2 import Event  # type: ignore[import-untyped]
from tensorboard.compat.proto.summary_pb2 import Summary  # type: ignore[import-untyped]
from tensorboard.summary.writer.record_writer import RecordWriter  # type: ignore[import-untyped]

from athrl_evaluator.results import append

log = logging.getLogger(__name__)


class EventFiles:
    """Writes scalars over environment steps; what a full disk does not take is missing in the curves.

    TensorBoard's own writer is not used: after one failed write it refuses all that follow.
    """

    def __init__(self, folder: Path) -> None:
        name = f"events.out.tfevents.{time.time():017.6f}.{socket.gethostname()}.{os.getpid()}"
        self._path = folder / name
        self._begun = False
        self._missing = False
        self._lock = threading.Lock()

    def add(self, prefix: str, values: Mapping[str, float], environment_steps: int, wall_time: float) -> None:
        """Add each value as the scalar `prefix/name`; values that are not finite are left out."""
        scalars = [
            Summary.Value(tag=f"{prefix}/{name}", simple_value=value)
            for name, value in sorted(values.items())
            if math.isfinite(value)
        ]
        event = Event(wall_time=wall_time, step=environment_steps, summary=Summary(value=scalars))
        with self._lock:
            self._write(event)

    def _write(self, event: Event) -> None:
        first = [] if self._begun else [Event(wall_time=event.wall_time, file_version="brain.Event:2")]
        content = io.BytesIO()
        records = RecordWriter(content)
        for each in [*first, event]:
            records.write(each.SerializeToString())
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            append(content.getvalue(), self._path)
        except OSError as error:
            if not self._missing:
                log.warning("cannot write %s: %s; curves go on when it can", self._path, error.strerror)
            self._missing = True
        else:
            self._begun, self._missing = True, False
