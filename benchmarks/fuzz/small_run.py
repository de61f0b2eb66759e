"""A small run with a checkpoint and a log, which is resumed again and again from files that were broken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from athrl_learner import factories
from athrl_learner.checkpoint import CheckpointContent, newest_intact_checkpoint, write_checkpoint
from athrl_learner.checkpoint.snapshot import restore_snapshot, take_snapshot
from athrl_learner.components import make_experience
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.intake.local_intake import LocalIntake
from athrl_learner.intake.store import ExperienceStore
from athrl_learner.log import SegmentLog
from athrl_planners.registry import settings_tables
from athrl_protocol import Chunk, LevelColumns, read_run_file
from athrl_protocol.delivery.ledger import Ledger
from athrl_protocol.run_file import declare_planners

LENGTH, CHUNKS, LATER_CHUNKS = 5, 12, 6
SETTINGS = (
    "run.name=small",
    "run.environment_steps=400",
    "planner.kind=ddpg",  # which has the fewest tensors
    "planner.hidden_features=16",
    "planner.head_features=16",
    "planner.critic=scalar",
    "environment.image_size=8",
    "exploration.random_decisions=20",
    "replay.capacity=100",
    f"replay.sequence_length={LENGTH}",
    f"learner.batch={LENGTH}",
    "learner.samples_per_insert=0.001",
    "learner.threads=1",
    "learner.precision=float32",
    "durability.segment_mebibytes=0.01",
)


class SmallRun:
    """Its folder, and what a learner does when it resumes it.

    Attributes:
        checkpoint: the folder of its only checkpoint.
        segments: the segments of its log, with the contents that they should have.
    """

    def __init__(self, folder: Path) -> None:
        declare_planners(settings_tables())
        self._run_file = read_run_file(None, SETTINGS)
        self._agent = factories.make_agent(self._run_file)
        self._checkpoints, self._experience = folder / "checkpoints", folder / "experience"
        log = factories.make_log(self._run_file, self._experience)
        self.checkpoint = self._lived(log)
        log.close()
        self.segments = {path: path.read_bytes() for path in sorted(self._experience.iterdir())}

    def resume(self) -> None:
        """Resume from the checkpoint and the log as they are now; raises LearnerError if they are damaged."""
        self.restore(self.newest())

    def newest(self) -> CheckpointContent:
        """Return the checkpoint that the run would be resumed from; raises LearnerError."""
        found = newest_intact_checkpoint(self._checkpoints, self._experience)
        assert found is not None
        return found[1]

    def restore(self, content: CheckpointContent) -> None:
        """Restore a checkpoint, and what the log has after it; raises LearnerError if they do not fit."""
        log = factories.make_log(self._run_file, self._experience)
        try:
            restored = restore_snapshot(content, self._agent, self._store(log))
            restored.ledger.to_json()
        finally:
            log.close()

    def repair(self) -> None:
        """Write the segments again as they were, after one was broken or cut off."""
        for path, content in self.segments.items():
            path.write_bytes(content)

    def _store(self, log: SegmentLog) -> ExperienceStore:
        return make_experience(self._run_file, self._agent, Arrivals(), log)

    def _lived(self, log: SegmentLog) -> Path:
        """Take chunks in, write a checkpoint, and take more in."""
        generator = np.random.default_rng(0)
        store = self._store(log)
        intake = LocalIntake(store, Ledger())
        for _ in range(CHUNKS):
            intake.take_in(self._chunk(generator))
        snapshot = take_snapshot(self._run_file, self._agent, store, intake, policy_version=3)
        for _ in range(LATER_CHUNKS):
            intake.take_in(self._chunk(generator))
        store.refuse(self._chunk(generator))
        return write_checkpoint(self._checkpoints, snapshot)

    def _chunk(self, generator: np.random.Generator) -> Chunk:
        rewards, states = np.zeros(LENGTH, np.float32), np.zeros((1, 0), np.float32)
        levels = {
            level.name: LevelColumns(
                generator.uniform(level.low, level.high, (LENGTH, level.action_size)).astype(np.float32),
                rewards,
                states,
            )
            for level in self._agent.description.levels
        }
        return Chunk(
            actor="actor-1",
            incarnation=1,
            sequence=0,  # the intake numbers it
            environment=0,
            episode_seed=7,
            first_step=0,
            length=LENGTH,
            state_interval=LENGTH,
            images=generator.integers(0, 2, (LENGTH + 1, 8, 8, 4), dtype=np.uint8) * np.uint8(255),
            motion=generator.uniform(-1, 1, (LENGTH + 1, 2)).astype(np.float32),
            levels=levels,
            policy_version=np.zeros(LENGTH, np.int64),
            terminated=False,
            truncated=False,
        )
