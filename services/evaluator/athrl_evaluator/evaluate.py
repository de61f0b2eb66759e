"""Score one driver: what `athrl evaluate` does, and the evaluator for each policy version."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from athrl_driving.policy import GuardedBatch, OnnxPolicy, PolicyMetadata, environment_config
from athrl_protocol.run_file import ActorSection, EnvironmentSection

from athrl_evaluator.drivers import REFERENCE_DRIVERS, BatchDriver, GreedyPolicy, ReferenceDriver
from athrl_evaluator.episodes import Onlooker, drive_episodes
from athrl_evaluator.scores import Scores, score


def evaluate_driver(
    driver: OnnxPolicy | Path | str,
    *,
    environment: EnvironmentSection | None = None,
    episodes: int,
    seed: int,
    batch: int = 8,
    onlookers: Sequence[Onlooker] = (),
) -> Scores:
    """Drive `episodes` (at least 2) episodes on the seeds `seed`, `seed + 1`, ... and score them.

    `driver` is a policy, a policy file, or one of REFERENCE_DRIVERS by name. A policy drives an environment
    with the image size and the action ranges that it was trained for; the rest is `environment`'s. The scores
    do not depend on `batch`, the number of environments stepped together.
    Raises InvalidPolicy for a file that is not a policy, and EnvironmentFailure where an environment fails.
    """
    section = environment or EnvironmentSection()
    policy = None if driver in REFERENCE_DRIVERS else _load(driver)
    if policy is not None:
        section = environment_for(policy.metadata, section)
    environments = make_batch(section, min(batch, episodes))
    try:
        drives = make_batch_driver(policy if policy is not None else str(driver), len(environments))
        return score(drive_episodes(drives, environments, range(seed, seed + episodes), onlookers))
    finally:
        environments.close()


def make_batch(
    section: EnvironmentSection, count: int, stall_seconds: float = ActorSection().stall_seconds
) -> GuardedBatch:
    """`count` environments as the run file describes them; a step that takes longer raises an error."""
    settings = section.model_dump()
    town = settings.pop("town")
    return GuardedBatch(town, environment_config(**settings), count, seconds=stall_seconds)


def make_batch_driver(driver: OnnxPolicy | str, count: int, policy_version: int = 0) -> BatchDriver:
    """A driver of `count` environments: a policy, or one of REFERENCE_DRIVERS by name."""
    if isinstance(driver, OnnxPolicy):
        return GreedyPolicy(driver, count, policy_version)
    return ReferenceDriver(driver, count)


def environment_for(metadata: PolicyMetadata, section: EnvironmentSection) -> EnvironmentSection:
    """The environment that a policy was trained for: its image size and the ranges of its actions."""
    changes: dict[str, float] = {"image_size": metadata.image_shape[0]}
    for action in metadata.acting_level.actions:
        if action.name == "target_speed":
            changes["maximum_speed"] = action.high
        elif action.name == "waypoint_angle":
            changes["waypoint_half_angle"] = math.degrees(action.high)
    return section.model_copy(update=changes)


def _load(driver: OnnxPolicy | Path | str) -> OnnxPolicy:
    return driver if isinstance(driver, OnnxPolicy) else OnnxPolicy.load(driver)
