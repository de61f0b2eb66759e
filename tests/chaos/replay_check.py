"""Checks the replay of a resumed learner: it must hold exactly the newest chunks of the log."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from athrl_learner import factories
from athrl_learner.checkpoint import newest_intact_checkpoint
from athrl_learner.checkpoint.snapshot import restore_snapshot
from athrl_learner.components import make_experience
from athrl_learner.intake.arrivals import Arrivals
from athrl_planners import Sequence, SequenceReplay
from athrl_protocol import decode_chunk
from athrl_protocol.run_file import RunFile

from tests.chaos.audit import Log


def replay_differences(run_folder: Path, settings: RunFile, log: Log) -> list[str]:
    """Restore the last checkpoint as a learner does, from a copy; return differences, one line each."""
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch)
        for part in ("checkpoints", "experience"):
            shutil.copytree(run_folder / part, copy / part)
        found = newest_intact_checkpoint(copy / "checkpoints")
        if found is None:
            return ["there is no checkpoint that could be restored"]
        agent = factories.make_agent(settings)
        segments = factories.make_log(settings, copy / "experience")
        store = make_experience(settings, agent, Arrivals(), segments)
        restored = restore_snapshot(found[1], agent, store)
        segments.close()
    differences = []
    if restored.recovered or restored.damaged:
        differences.append(
            f"after an orderly end {restored.recovered} chunks came after the last checkpoint, "
            f"{restored.damaged} are damaged"
        )
    slots = store.replay.slots
    newest = [decode_chunk(message) for message in log.messages[-slots:]]
    expected = [_digest(sequence) for chunk in newest for sequence in store.reader.sequences(chunk)][-slots:]
    there = [_digest(sequence) for sequence in _sequences(store.replay)]
    if there != expected:
        wrong = sum(one != other for one, other in zip(there, expected, strict=False))
        differences.append(
            f"the restored replay holds {len(there)} sequences, should hold the newest {len(expected)} "
            f"of the log; {wrong} differ"
        )
    return differences


def _sequences(replay: SequenceReplay) -> Iterator[Sequence]:
    """The replay's sequences, oldest first."""
    columns = replay._columns
    levels = [name.removesuffix(".rewards") for name in columns if name.endswith(".rewards")]
    for number in range(replay._inserted - replay.sequences, replay._inserted):
        slot = number % replay.slots

        def of_levels(column: str, slot: int = slot) -> dict[str, np.ndarray]:
            return {level: columns[f"{level}.{column}"][slot] for level in levels}

        yield Sequence(
            images=columns["images"][slot],
            motion=columns["motion"][slot],
            actions=of_levels("actions"),
            rewards=of_levels("rewards"),
            initial_state=of_levels("initial_state"),
            length=int(columns["length"][slot]),
            terminated=bool(columns["terminated"][slot]),
        )


def _digest(sequence: Sequence) -> str:
    digest = hashlib.sha256(f"{sequence.length} {sequence.terminated}".encode())
    columns: list[Any] = [sequence.images, sequence.motion]
    for by_level in (sequence.actions, sequence.rewards, sequence.initial_state):
        columns += [by_level[level] for level in sorted(by_level)]
    for column in columns:
        digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()
