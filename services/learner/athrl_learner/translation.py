"""From the run file to what the planners' room takes: it knows no run file, this room does."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from athrl_planners import ActionRange, AtHRL, ObservationSettings, PlannerSettings, SequenceReplay
from athrl_protocol import RunFile

from athrl_learner.device import training_device
from athrl_learner.experience import ChunkReader, ExpectedLevel
from athrl_learner.limiter import SamplesPerInsert
from athrl_learner.segments import SegmentLog

#: The learner's branch in the run's tree of seeds, and its two leaves.
_LEARNER = 1
_AGENT, _REPLAY = 0, 1


def observation_settings(run_file: RunFile) -> ObservationSettings:
    """What the planner sees."""
    return ObservationSettings(image_size=run_file.environment.image_size)


def planner_settings(run_file: RunFile) -> PlannerSettings:
    """How the planner learns: the run file's section, field by field."""
    values = run_file.planner.model_dump(exclude={"kind"})
    return PlannerSettings(**values, burn_in=run_file.replay.burn_in)


def action_ranges(run_file: RunFile) -> dict[str, tuple[ActionRange, ...]]:
    """What each level decides, in physical units, and how actors explore it."""
    environment, exploration = run_file.environment, run_file.exploration
    half_angle = math.radians(environment.waypoint_half_angle)
    return {
        "intention": (
            ActionRange(
                name="intention",
                unit="",
                low=0.0,
                high=2.0,
                noise="ornstein-uhlenbeck",
                noise_scale=exploration.intention_noise,
                damping=exploration.damping,
            ),
        ),
        "trajectory": (
            ActionRange(
                name="target_speed",
                unit="m/s",
                low=0.0,
                high=environment.maximum_speed,
                noise="ornstein-uhlenbeck",
                noise_scale=exploration.speed_noise,
                damping=exploration.damping,
            ),
            ActionRange(
                name="waypoint_angle",
                unit="rad",
                low=-half_angle,
                high=half_angle,
                noise="gaussian",
                noise_scale=exploration.waypoint_noise,
            ),
        ),
    }


def make_agent(run_file: RunFile) -> AtHRL:
    """A fresh planner as the run file describes it."""
    return AtHRL(
        planner_settings(run_file),
        observation_settings(run_file),
        action_ranges(run_file),
        seed=_seed(run_file, _AGENT),
        device=training_device(run_file),
    )


def make_replay(run_file: RunFile, agent: AtHRL) -> SequenceReplay:
    """An empty replay for that planner."""
    return SequenceReplay(
        capacity_transitions=run_file.replay.capacity,
        sequence_length=run_file.replay.sequence_length,
        observation=agent.observation,
        levels=agent.level_sizes,
        seed=_seed(run_file, _REPLAY),
    )


def make_reader(run_file: RunFile, agent: AtHRL) -> ChunkReader:
    """The check that a chunk fits that planner."""
    levels = {
        name: ExpectedLevel(actions=agent.actions[name], state_size=state_size)
        for name, (_, state_size) in agent.level_sizes.items()
    }
    return ChunkReader(agent.observation, run_file.replay.sequence_length, run_file.longest_chunk, levels)


def make_limiter(run_file: RunFile) -> SamplesPerInsert:
    """The limiter; the warm-up is as long as the random decisions."""
    return SamplesPerInsert(
        ratio=run_file.learner.samples_per_insert,
        tolerance=run_file.learner.samples_per_insert_tolerance,
        minimum_inserts=max(1, run_file.exploration.random_decisions),
        largest_insert=run_file.longest_chunk,
        largest_sample=run_file.learner.batch * run_file.replay.sequence_length,
    )


def make_log(run_file: RunFile, folder: Path) -> SegmentLog:
    """The log of experience in `folder`."""
    durability = run_file.durability
    return SegmentLog(
        folder,
        segment_bytes=round(durability.segment_mebibytes * 2**20),
        fsync=durability.fsync,
        reserve_bytes=round(durability.reserve_mebibytes * 2**20),
    )


def _seed(run_file: RunFile, leaf: int) -> int:
    sequence = np.random.SeedSequence(run_file.run.seed, spawn_key=(_LEARNER, leaf))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))
