"""What a checkpoint holds, and what its parts are called."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

#: Raised when a checkpoint is laid out differently from before.
FORMAT = 1
MANIFEST = "manifest.json"
STATE = "state.json"
AGENT = "agent.pt"
REPLAY = "replay"
ARRAY_SUFFIX = ".npy.zst"
UNFINISHED_SUFFIX = ".part"

_NAME = re.compile(r"checkpoint-(\d{6,})")


@dataclass(frozen=True)
class CheckpointContent:
    """A learner's whole state at one moment between two updates.

    Attributes:
        state: JSON-able: run file, counters, limiter, ledger, replay's plain values, random states.
        agent: nested dictionaries and lists of tensors and plain values.
        replay: the replay's arrays by name; may be views of the live ones while nothing is inserted.
    """

    state: dict[str, Any]
    agent: dict[str, Any]
    replay: dict[str, np.ndarray]


def checkpoint_name(number: int) -> str:
    """The folder name of checkpoint `number`."""
    return f"checkpoint-{number:06d}"


def numbered_checkpoints(folder: Path) -> list[tuple[int, Path]]:
    """All finished checkpoints in `folder`, oldest first, with their numbers."""
    found = []
    for path in folder.iterdir() if folder.is_dir() else ():
        match = _NAME.fullmatch(path.name)
        if match and path.is_dir():
            found.append((int(match[1]), path))
    return sorted(found)
