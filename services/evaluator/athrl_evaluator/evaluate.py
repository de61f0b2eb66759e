"""Score one driver: what `athrl evaluate` does."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from athrl_driving.policy import OnnxPolicy
from athrl_protocol.run_file import ActorSection, EnvironmentSection

from athrl_evaluator.drivers import REFERENCE_DRIVERS, BatchDriver, GreedyPolicy, ReferenceDriver
from athrl_evaluator.environments import Environments, environment_for, require_fitting, town_labels
from athrl_evaluator.episodes import Onlooker, drive_episodes
from athrl_evaluator.errors import EvaluatorError
from athrl_evaluator.forcing import read_forced
from athrl_evaluator.onlookers import Recorder
from athrl_evaluator.policy_files import load_policy
from athrl_evaluator.scores import EpisodeResult, Scores, score


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
    forced: Sequence[str] = (),
    onlookers: Sequence[Onlooker] = (),
) -> Scores:
    """Drive `episodes` episodes, 2 or more, on the seeds `seed`, `seed + 1`, ... in each town; score them.

    Args:
        driver: a policy, a policy file, or one of REFERENCE_DRIVERS by name. A policy drives an environment
            with the image size and the limits that it was trained for.
        environment: everything else of the environment, and its towns.
        case_study: drive this one instead (see `make_batch`).
        episodes: in each town.
        seed: of the first episode.
        batch: environments that are stepped together, which the scores do not depend on.
        stall_seconds: within which a step returns.
        record: folder in which each episode is recorded as an MCAP file, named after the policy's file.
        forced: decisions of the policy that are forced, each as NAME=VALUE.
        onlookers: are told of every step.

    Raises:
        InvalidPolicy: a file is not a policy, or not the one of which the facts beside it tell.
        RunFileError: `environment` names a value that the policy was not made for.
        CannotForce: the policy does not decide what is to be forced.
        EnvironmentFailure: an environment fails or takes longer than `stall_seconds`.
        EvaluatorError: the disk does not take the recordings, or something is to be forced on no policy.
    """
    section = environment or EnvironmentSection()
    policy = None if driver in REFERENCE_DRIVERS else _load(driver)
    if policy is not None:
        require_fitting(policy.description, section)
        section = environment_for(policy.description, section)
    elif forced:
        raise EvaluatorError(f"--force {forced[0]}: {driver} is no policy, nothing can be forced on it")
    with ExitStack() as stack:
        environments = Environments(section, min(batch, episodes), stall_seconds, case_study)
        stack.callback(environments.close)
        labels, results = town_labels(environments.towns), list[EpisodeResult]()
        for town in environments.towns:
            drives = make_batch_driver(
                policy if policy is not None else str(driver), min(batch, episodes), forced=forced
            )
            looking = list(onlookers)
            if record is not None:
                named = [driver.stem if isinstance(driver, Path) else drives.name]
                named += [labels[town]] if len(labels) > 1 else []
                recorder = Recorder(
                    drives, record, episodes=episodes, kept=None, needed=True, named="-".join(named)
                )
                stack.callback(recorder.close)
                looking.insert(0, recorder)
            at = environments.batch(town, drives.action_kind)
            results += drive_episodes(drives, at, range(seed, seed + episodes), looking)
        return score(results)


def make_batch_driver(
    driver: OnnxPolicy | str, count: int, policy_version: int = 0, forced: Sequence[str] = ()
) -> BatchDriver:
    """A driver of `count` environments: a policy, or one of REFERENCE_DRIVERS by name.

    Raises:
        CannotForce: the policy does not decide what is to be forced.
    """
    if isinstance(driver, OnnxPolicy):
        return GreedyPolicy(driver, count, policy_version, read_forced(forced, driver.description))
    return ReferenceDriver(driver, count)


def _load(driver: OnnxPolicy | Path | str) -> OnnxPolicy:
    return driver if isinstance(driver, OnnxPolicy) else load_policy(Path(driver))
