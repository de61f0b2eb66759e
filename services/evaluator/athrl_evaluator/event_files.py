"""TensorBoard event files of all services' metrics and of evaluations, without torch or TensorFlow.

Each file also has the layout of the run's page.
"""

from __future__ import annotations

import io
import logging
import math
import os
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from athrl_protocol.faults.bounded_log import RareLog
from athrl_spaces.wording import system_reason
from tensorboard.compat.proto.event_pb2 import Event  # type: ignore[import-untyped]
from tensorboard.compat.proto.summary_pb2 import Summary  # type: ignore[import-untyped]
from tensorboard.summary.writer.record_writer import RecordWriter  # type: ignore[import-untyped]

from athrl_evaluator.dashboard import layout_value, links_value
from athrl_evaluator.scoring.results import append

log = logging.getLogger(__name__)


class EventFiles:
    """Writes scalars over environment steps; values that a full disk rejects are missing in the curves.

    TensorBoard's own writer is not used: after one failed write it fails for all later ones.
    """

    def __init__(
        self, folder: Path, warn: Callable[[str], object] | None = None, *, reserve_bytes: int = 0
    ) -> None:
        """Write into a folder.

        Args:
            folder: is made when it is needed.
            warn: is called with a text when the file cannot be written.
            reserve_bytes: with less free space nothing is written: it is for the learner's checkpoints.
        """
        self._reserve = reserve_bytes
        name = f"events.out.tfevents.{time.time():017.6f}.{socket.gethostname()}.{os.getpid()}"
        self._path = folder / name
        self._begun = False
        self._warn = warn or RareLog(log.warning)
        self._lock = threading.Lock()

    def add(self, prefix: str, values: Mapping[str, float], environment_steps: int, wall_time: float) -> None:
        """Add each value as the scalar `prefix/name`; values that are not finite are left out."""
        scalars = [
            Summary.Value(tag=f"{prefix}/{name}", simple_value=value)
            for name, value in sorted(values.items())
            if math.isfinite(value)
        ]
        self._write(Event(wall_time=wall_time, step=environment_steps, summary=Summary(value=scalars)))

    def add_links(self, recordings: Path, environment_steps: int, wall_time: float) -> None:
        """Say where the live episode and the newest recordings, in this folder, are seen."""
        links = Summary(value=[links_value(recordings)])
        self._write(Event(wall_time=wall_time, step=environment_steps, summary=links))

    def _write(self, event: Event) -> None:
        with self._lock:
            self._append([event] if self._begun else [*_beginning(event.wall_time), event])

    def _append(self, events: Sequence[Event]) -> None:
        content = io.BytesIO()
        records = RecordWriter(content)
        for each in events:
            records.write(each.SerializeToString())
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            room = os.statvfs(self._path.parent)
            if room.f_bavail * room.f_frsize < self._reserve:
                self._warn(
                    f"the disk of {self._path.parent} has less than the reserve of "
                    f"{self._reserve / 2**20:,.0f} MiB; curves continue when it has more"
                )
                return
            append(content.getvalue(), self._path)
        except OSError as error:
            self._warn(
                f"cannot write {self._path}: {system_reason(error)}; curves continue when it can be written"
            )
        else:
            self._begun = True


def _beginning(wall_time: float) -> list[Event]:
    """What each file begins with."""
    return [
        Event(wall_time=wall_time, file_version="brain.Event:2"),
        Event(wall_time=wall_time, summary=Summary(value=[layout_value()])),
    ]
