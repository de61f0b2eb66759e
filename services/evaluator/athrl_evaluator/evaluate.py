"""Score one driver: what `athrl evaluate` does, and the evaluator for each policy version."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from athrl_driving.policy import GuardedBatch, OnnxPolicy, PolicyMetadata, environment_config
from athrl_protocol import RunFileError
from athrl_protocol.run_file import ActorSection, EnvironmentSection

from athrl_evaluator.case_studies import case_study_settings
from athrl_evaluator.drivers import REFERENCE_DRIVERS, BatchDriver, GreedyPolicy, ReferenceDriver
from athrl_evaluator.episodes import Onlooker, drive_episodes
from athrl_evaluator.onlookers import Recorder
from athrl_evaluator.policy_files import load_policy
from athrl_evaluator.scores import Scores, score

_SETTING_OF_KEY = {"vehicles": "vehicles_count"}
"""Keys of the run file that have another name among an environment's settings."""


def evaluate_driver(
    driver: OnnxPolicy | Path | str,
    *,
    environment: EnvironmentSection | None = None,
    case_study: str | None = None,
    episodes: int,
    seed: int,
    batch: int = 8,
    stall_seconds: float = ActorSection().stall_seconds,
    record: Path | None = None,
    onlookers: Sequence[Onlooker] = (),
) -> Scores:
    """Drive `episodes` (at least 2) episodes on the seeds `seed`, `seed + 1`, ... and score them.

    `driver` is a policy, a policy file, or one of REFERENCE_DRIVERS by name. A policy drives an environment
    with the image size and the action ranges that it was trained for; the rest is `environment`'s, or that of
    the case study (see `make_batch`). The scores do not depend on `batch`, the number of environments stepped
    together. Each episode is recorded as an MCAP file, named after the policy's file, in the folder `record`
    if there is one.

    Raises InvalidPolicy for a file that is not a policy, or not the one of which the facts beside it tell,
    RunFileError where `environment` names a value that the policy was not made for, EnvironmentFailure where
    an environment fails or takes longer than `stall_seconds`, and EvaluatorError where the disk does not take
    the recordings.
    """
    section = environment or EnvironmentSection()
    policy = None if driver in REFERENCE_DRIVERS else _load(driver)
    if policy is not None:
        require_fitting(policy.metadata, section)
        section = environment_for(policy.metadata, section)
    environments = make_batch(section, min(batch, episodes), stall_seconds, case_study)
    with ExitStack() as stack:
        stack.callback(environments.close)
        drives = make_batch_driver(policy if policy is not None else str(driver), len(environments))
        if record is not None:
            town = environments.environments[0].config["town"]
            named = driver.stem if isinstance(driver, Path) else None
            recorder = Recorder(drives, town, record, episodes=episodes, kept=None, needed=True, named=named)
            stack.callback(recorder.close)
            onlookers = [recorder, *onlookers]
        return score(drive_episodes(drives, environments, range(seed, seed + episodes), onlookers))


def make_batch(
    section: EnvironmentSection,
    count: int,
    stall_seconds: float = ActorSection().stall_seconds,
    case_study: str | None = None,
) -> GuardedBatch:
    """`count` environments as the run file describes them; a step that takes longer raises an error.

    Of a case study, one of CASE_STUDIES, are the town, the start, the destination and where the traffic is,
    and its number of vehicles and ticks unless `section` was made with others.
    """
    settings = section.model_dump()
    config = environment_config(**{name: value for name, value in settings.items() if name != "town"})
    if case_study is None:
        return GuardedBatch(section.town, config, count, seconds=stall_seconds)
    fixed = case_study_settings(case_study)
    given = {_SETTING_OF_KEY.get(key, key) for key in section.model_fields_set} - {"town"}
    config |= {name: value for name, value in fixed.items() if name not in given}
    return GuardedBatch(config["town"], config, count, seconds=stall_seconds)


def make_batch_driver(driver: OnnxPolicy | str, count: int, policy_version: int = 0) -> BatchDriver:
    """A driver of `count` environments: a policy, or one of REFERENCE_DRIVERS by name."""
    if isinstance(driver, OnnxPolicy):
        return GreedyPolicy(driver, count, policy_version)
    return ReferenceDriver(driver, count)


def environment_for(metadata: PolicyMetadata, section: EnvironmentSection) -> EnvironmentSection:
    """The environment that a policy was trained for: its image size and the ranges of its actions."""
    return section.model_copy(update=_fixed_by_policy(metadata))


def require_fitting(metadata: PolicyMetadata, section: EnvironmentSection) -> None:
    """Raise RunFileError where a setting that was given, and is no default, is not what the policy needs."""
    for key, value in _fixed_by_policy(metadata).items():
        given = getattr(section, key)
        if key in section.model_fields_set and not math.isclose(given, value, rel_tol=1e-5):
            raise RunFileError(
                f"environment.{key} is {given:g}, but the policy was made for {value:g}: leave it out"
            )


def _fixed_by_policy(metadata: PolicyMetadata) -> dict[str, float]:
    """The settings of an environment that follow from a policy, by their keys in the run file."""
    fixed: dict[str, float] = {"image_size": metadata.image_shape[0]}
    for action in metadata.acting_level.actions:
        if action.name == "target_speed":
            fixed["maximum_speed"] = action.high
        elif action.name == "waypoint_angle":
            fixed["waypoint_half_angle"] = math.degrees(action.high)
    return fixed


def _load(driver: OnnxPolicy | Path | str) -> OnnxPolicy:
    return driver if isinstance(driver, OnnxPolicy) else load_policy(Path(driver))
