"""Scores one driver, for `athrl evaluate`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from athrl_driving.policy import OnnxPolicy
from athrl_protocol.run_file import ActorSection, EnvironmentSection
from athrl_spaces import REFERENCE_DRIVERS

from athrl_evaluator.errors import EvaluatorError
from athrl_evaluator.policies.files import load_policy
from athrl_evaluator.recording.recorder import Recorder, recording_path
from athrl_evaluator.scoring.drivers import BatchDriver, GreedyPolicy, ReferenceDriver
from athrl_evaluator.scoring.environments import Environments, environment_for, require_fitting, town_labels
from athrl_evaluator.scoring.episodes import EpisodeObserver, drive_episodes
from athrl_evaluator.scoring.forced_decisions import read_forced
from athrl_evaluator.scoring.scores import EpisodeResult, Scores, score


@dataclass(frozen=True)
class EvaluationSettings:
    """What is driven in an evaluation.

    Attributes:
        episodes: in each town, 2 or more.
        seed: of the first episode; the others have `seed + 1`, `seed + 2`, ...
        environment: settings of the environment and its towns; None: the defaults. A policy drives with the
            image size and the limits that it was trained for.
        case_study: drive this one instead of the towns (see `make_batch`).
        forced: decisions of the policy that are forced, each as NAME=VALUE.
        batch: environments that are stepped together; the scores do not depend on it.
        stall_seconds: within which a step returns.
    """

    episodes: int
    seed: int
    environment: EnvironmentSection | None = None
    case_study: str | None = None
    forced: Sequence[str] = ()
    batch: int = 8
    stall_seconds: float = ActorSection().stall_seconds


def evaluate_driver(
    driver: OnnxPolicy | Path | str,
    settings: EvaluationSettings,
    *,
    record: Path | None = None,
) -> Scores:
    """Drive the episodes of an evaluation and score them.

    Args:
        driver: a policy, a policy file, or one of REFERENCE_DRIVERS by name.
        settings: what is driven.
        record: folder in which each episode is recorded as an MCAP file, named after the policy's file;
            one that is there is replaced.

    Raises:
        InvalidPolicy: a file is not a policy, or not the one that the JSON file beside it describes.
        RunFileError: `settings.environment` names a value that the policy was not made for.
        CannotForce: the policy does not decide a value that is to be forced.
        EnvironmentFailure: an environment fails or takes longer than `settings.stall_seconds`.
        EvaluatorError: the recordings cannot be written, or a decision is forced but the driver is no policy.
    """
    who, section = fitted(driver, settings.environment or EnvironmentSection(), settings.forced)
    count = min(settings.batch, settings.episodes)
    seeds = range(settings.seed, settings.seed + settings.episodes)
    with ExitStack() as stack:
        environments = Environments(section, count, settings.stall_seconds, settings.case_study)
        stack.callback(environments.close)
        labels, results = town_labels(environments.towns), list[EpisodeResult]()
        for town in environments.towns:
            batch_driver = make_batch_driver(who, count, forced=settings.forced)
            observers: list[EpisodeObserver] = []
            if record is not None:
                named = "-".join([_name(driver), *([labels[town]] if len(labels) > 1 else [])])
                policy = driver.stem if isinstance(driver, Path) else ""
                recorder = Recorder(
                    batch_driver,
                    record,
                    episodes=len(seeds),
                    kept=None,
                    needed=True,
                    named=named,
                    policy=policy,
                )
                stack.callback(recorder.close)
                observers.append(recorder)
            batch = environments.batch(town, batch_driver.action_kind)
            results += drive_episodes(batch_driver, batch, seeds, observers)
        return score(results)


def recordings_of(driver: Path | str, settings: EvaluationSettings, folder: Path) -> list[Path]:
    """The files into which `evaluate_driver` records the episodes of one town or case study."""
    seeds = range(settings.seed, settings.seed + settings.episodes)
    return [recording_path(folder, _name(driver), seed) for seed in seeds]


def _name(driver: OnnxPolicy | Path | str) -> str:
    """The driver in the names of its recordings."""
    if isinstance(driver, OnnxPolicy):
        return GreedyPolicy.name
    return driver.stem if isinstance(driver, Path) else driver


def fitted(
    driver: OnnxPolicy | Path | str, environment: EnvironmentSection, forced: Sequence[str] = ()
) -> tuple[OnnxPolicy | str, EnvironmentSection]:
    """A policy or the name of a reference driver, and the settings of the environments that it drives in.

    A policy drives with the image size and the limits that it was trained for.

    Args:
        driver: a policy, a policy file, or one of REFERENCE_DRIVERS by name.
        environment: the settings that are wanted.
        forced: decisions that are to be forced, each as NAME=VALUE.

    Raises:
        InvalidPolicy: a file is not a policy, or not the one that the JSON file beside it describes.
        RunFileError: `environment` names a value that the policy was not made for.
        EvaluatorError: a decision is to be forced, but the driver is no policy.
    """
    if driver in REFERENCE_DRIVERS:
        if forced:
            raise EvaluatorError(f"--force {forced[0]}: {driver} is no policy, nothing can be forced on it")
        return str(driver), environment
    policy = driver if isinstance(driver, OnnxPolicy) else load_policy(Path(driver))
    require_fitting(policy.description, environment)
    return policy, environment_for(policy.description, environment)


def make_batch_driver(
    driver: OnnxPolicy | str, count: int, policy_version: int = 0, forced: Sequence[str] = ()
) -> BatchDriver:
    """A driver of `count` environments: a policy, or one of REFERENCE_DRIVERS by name.

    Raises:
        CannotForce: the policy does not decide a value that is to be forced.
    """
    if isinstance(driver, OnnxPolicy):
        return GreedyPolicy(driver, count, policy_version, read_forced(forced, driver.description))
    return ReferenceDriver(driver, count)
