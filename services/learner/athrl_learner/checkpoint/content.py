"""What a checkpoint holds, and what its parts are called."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from athrl_learner.log import LogPosition
from athrl_learner.log.segments import LARGEST_NUMBER

#: Incremented when the layout of a checkpoint changes.
FORMAT = 4
MANIFEST = "manifest.json"
STATE = "state.json"
AGENT = "agent.pt"
ACTOR = "actor.pt"
UNFINISHED_SUFFIX = ".part"

_NAME = re.compile(r"checkpoint-([0-9]{6,18})")


@dataclass(frozen=True)
class CheckpointContent:
    """A learner's complete state between two updates.

    Attributes:
        state: JSON-able: run file, counters, limiter, ledger, the replay's order, random states.
        agent: the planner and the replay's priorities: nested dictionaries and lists of tensors and plain
            values.
        log: position in the log, and the segments that hold the replay.
        actor: of a serial run, the complete state of its actor, nested in the same way; None of a
            distributed run, whose actors are separate processes.
    """

    state: dict[str, Any]
    agent: dict[str, Any]
    log: LogPosition
    actor: dict[str, Any] | None = None

    @property
    def policy_version(self) -> int:
        """The newest policy when the checkpoint was taken."""
        return int(self.state["policy_version"])


def manifest_checksum(values: dict[str, Any]) -> str:
    """SHA-256 of a manifest's values other than the checksum itself."""
    checked = {name: value for name, value in values.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(checked, sort_keys=True).encode()).hexdigest()


def checkpoint_name(number: int) -> str:
    """The folder name of checkpoint `number`."""
    return f"checkpoint-{number:06d}"


def numbered_checkpoints(folder: Path) -> list[tuple[int, Path]]:
    """All finished checkpoints in `folder`, oldest first, with their numbers."""
    found = []
    for path in folder.iterdir() if folder.is_dir() else ():
        match = _NAME.fullmatch(path.name)
        if match and int(match[1]) <= LARGEST_NUMBER and path.is_dir():
            found.append((int(match[1]), path))
    return sorted(found)
