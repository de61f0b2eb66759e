"""The environments of an evaluation: as in a run file, or as a policy was trained in."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import PurePath

from athrl_driving.policy import GuardedBatch, environment_config, spread_towns
from athrl_protocol import RunFileError
from athrl_protocol.run_file import ActorSection, EnvironmentSection
from athrl_spaces import WAYPOINT, PolicyDescription

from athrl_evaluator.scoring.case_studies import case_study_settings

_SETTING_OF_KEY = {"vehicles": "vehicles_count"}
"""Keys of the run file that have another name among an environment's settings."""

_OF_POLICY: dict[str, Callable[[PolicyDescription], float]] = {
    "image_size": lambda policy: policy.observation.image_size,
    "maximum_speed": lambda policy: policy.limits.maximum_speed,
    "waypoint_radius": lambda policy: policy.limits.waypoint_radius,
    "waypoint_half_angle": lambda policy: math.degrees(policy.limits.waypoint_half_angle),
    "speed_gain": lambda policy: policy.limits.speed_gain,
}
FIXED_BY_POLICY = frozenset(_OF_POLICY)
"""Keys of the run file whose values follow from the policy that drives."""


class Environments:
    """Batches of environments by town and kind of action; each is made when it is first needed.

    Args:
        section: the settings of all of them.
        count: of environments in a batch.
        stall_seconds: within which a step returns.
        case_study: replaces the section's towns.
    """

    def __init__(
        self,
        section: EnvironmentSection,
        count: int,
        stall_seconds: float = ActorSection().stall_seconds,
        case_study: str | None = None,
    ) -> None:
        self._section, self._count, self._stall_seconds = section, count, stall_seconds
        self._case_study = case_study
        self.towns = list(section.towns) if case_study is None else [case_study_settings(case_study)["town"]]
        self._batches: dict[tuple[str, str], GuardedBatch] = {}
        self._open = ExitStack()

    def batch(self, town: str, action_kind: str) -> GuardedBatch:
        """The environments of a town that take this kind of action."""
        if (town, action_kind) not in self._batches:
            batch = make_batch(
                in_town(self._section, town),
                self._count,
                self._stall_seconds,
                self._case_study,
                action_kind=action_kind,
            )
            self._batches[town, action_kind] = batch
            self._open.callback(batch.close)
        return self._batches[town, action_kind]

    def close(self) -> None:
        """Close all batches."""
        self._open.close()


def make_batch(
    section: EnvironmentSection,
    count: int,
    stall_seconds: float = ActorSection().stall_seconds,
    case_study: str | None = None,
    *,
    action_kind: str = WAYPOINT,
) -> GuardedBatch:
    """Make `count` environments as in the run file; a step longer than `stall_seconds` raises an error.

    A case study fixes town, start, destination, traffic and time limit; settings that the section names
    explicitly, apart from the town, take precedence.
    """
    settings = section.model_dump()
    shares = settings.pop("towns")
    config = environment_config(**settings)
    if case_study is None:
        towns = spread_towns(shares, count)
    else:
        fixed = case_study_settings(case_study)
        given = {_SETTING_OF_KEY.get(key, key) for key in section.model_fields_set} - {"town"}
        config |= {name: value for name, value in fixed.items() if name not in given}
        towns = [str(config.pop("town"))] * count
    return GuardedBatch(towns, config, action_kind, seconds=stall_seconds)


def in_town(section: EnvironmentSection, town: str) -> EnvironmentSection:
    """The same settings in one town alone."""
    return section.model_copy(update={"towns": {town: 1.0}})


def town_labels(towns: list[str]) -> dict[str, str]:
    """A unique short name for each town; for a map file its name without folder and extension."""
    labels: dict[str, str] = {}
    for town in towns:
        label, number = PurePath(town).stem, 1
        while label in labels.values():
            number += 1
            label = f"{PurePath(town).stem}-{number}"
        labels[town] = label
    return labels


def environment_for(description: PolicyDescription, section: EnvironmentSection) -> EnvironmentSection:
    """The environment that a policy was trained for: its observation, and the meaning of its actions."""
    return section.model_copy(update=_fixed_by_policy(description))


def require_fitting(description: PolicyDescription, section: EnvironmentSection) -> None:
    """Raise RunFileError if a given setting differs from what the policy was made for."""
    for key, value in _fixed_by_policy(description).items():
        given = getattr(section, key)
        if key in section.model_fields_set and not math.isclose(given, value, rel_tol=1e-5):
            raise RunFileError(
                f"environment.{key} is {given:g}, but the policy was made for {value:g}: leave it out"
            )


def _fixed_by_policy(description: PolicyDescription) -> dict[str, float]:
    """The settings of an environment that follow from a policy, by their keys in the run file."""
    return {key: value(description) for key, value in _OF_POLICY.items()}
