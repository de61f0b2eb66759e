"""Makes planner, replay, limiter and log from the run file; the package of planners knows no run file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from athrl_planners import Agent, SequenceReplay
from athrl_planners import make_agent as make_planner_agent
from athrl_planners.factories import make_replay as make_planner_replay
from athrl_protocol import RunFile
from athrl_spaces import Limits, Observation

from athrl_learner.errors import WrongPlanner
from athrl_learner.intake.chunk_validation import ChunkReader
from athrl_learner.intake.limiter import SamplesPerInsert
from athrl_learner.log import SegmentLog
from athrl_learner.training.device import share_threads, training_device, training_threads, update_precision

#: The learner's branch in the tree of seeds of the run, and its two leaves.
_LEARNER = 1
_AGENT, _REPLAY = 0, 1


def observation(run_file: RunFile) -> Observation:
    """What the planner sees."""
    return Observation(run_file.environment.image_size)


def limits(run_file: RunFile) -> Limits:
    """What environments make of a decision."""
    environment = run_file.environment
    return Limits(
        maximum_speed=environment.maximum_speed,
        waypoint_radius=environment.waypoint_radius,
        waypoint_half_angle=math.radians(environment.waypoint_half_angle),
        speed_gain=environment.speed_gain,
    )


def make_agent(run_file: RunFile) -> Agent:
    """A new planner as the run file describes it; logs the precision of its updates and the reason.

    Raises:
        WrongPlanner: its levels are not valid, or look farther ahead than the length of a sequence.
    """
    try:
        agent = make_planner_agent(
            run_file.planner.kind,
            run_file.planner.values(),
            observation=observation(run_file),
            limits=limits(run_file),
            seed=_seed(run_file, _AGENT),
            device=training_device(run_file),
            burn_in=run_file.replay.burn_in,
            precision=update_precision(run_file),
            threads=training_threads(run_file),
        )
    except ValueError as error:
        raise WrongPlanner(f"planner.kind = {run_file.planner.kind}: {error}") from None
    ahead, length = max(agent.prepare.horizons), run_file.replay.sequence_length
    if ahead > length:
        raise WrongPlanner(
            f"the planner looks {ahead} decisions ahead, in sequences of replay.sequence_length = {length}: "
            "should be at most that (planner.n_step, and for how long a level holds its decision)"
        )
    share_threads(run_file, agent)
    return agent


def make_replay(run_file: RunFile, agent: Agent) -> SequenceReplay:
    """An empty replay for that planner."""
    replay = run_file.replay
    return make_planner_replay(
        agent,
        replay.capacity,
        replay.sequence_length,
        _seed(run_file, _REPLAY),
        (replay.priority_exponent, replay.importance_exponent) if replay.prioritised else None,
    )


def make_reader(run_file: RunFile, agent: Agent) -> ChunkReader:
    """The check that chunks fit that planner."""
    return ChunkReader(agent.description, run_file.replay.sequence_length, run_file.longest_chunk)


def make_limiter(run_file: RunFile, agent: Agent) -> SamplesPerInsert:
    """The limiter; the warm-up is as long as the random decisions."""
    return SamplesPerInsert(
        ratio=run_file.learner.samples_per_insert,
        tolerance=run_file.learner.samples_per_insert_tolerance,
        minimum_inserts=max(1, run_file.warm_up),
        largest_insert=run_file.longest_chunk,
        largest_sample=_largest_sample(run_file, agent),
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


def _largest_sample(run_file: RunFile, agent: Agent) -> int:
    """Most decisions in an update: single ones, or whole sequences for a planner with memory."""
    batch, length = run_file.learner.batch, run_file.replay.sequence_length
    return max(1, round(batch / length)) * length if agent.has_memory else batch


def _seed(run_file: RunFile, leaf: int) -> int:
    sequence = np.random.SeedSequence(run_file.run.seed, spawn_key=(_LEARNER, leaf))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))
