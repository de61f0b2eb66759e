"""TensorBoard event files of everybody's metrics and of the evaluations, without torch or TensorFlow."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from tensorboard.compat.proto.event_pb2 import Event  # type: ignore[import-untyped]
from tensorboard.compat.proto.summary_pb2 import Summary  # type: ignore[import-untyped]
from tensorboard.summary.writer.event_file_writer import EventFileWriter  # type: ignore[import-untyped]


class EventFiles:
    """Writes scalars over environment steps."""

    def __init__(self, folder: Path) -> None:
        self._writer = EventFileWriter(str(folder), flush_secs=5)

    def add(self, prefix: str, values: Mapping[str, float], environment_steps: int, wall_time: float) -> None:
        """Add each value as the scalar `prefix/name`; values that are not finite are left out."""
        scalars = [
            Summary.Value(tag=f"{prefix}/{name}", simple_value=value)
            for name, value in sorted(values.items())
            if math.isfinite(value)
        ]
        event = Event(wall_time=wall_time, step=environment_steps, summary=Summary(value=scalars))
        self._writer.add_event(event)

    def close(self) -> None:
        """Write out what is still held back."""
        self._writer.close()
