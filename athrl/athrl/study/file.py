"""The file of a study: which runs it has, how they are scored, and over what it searches."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from athrl_protocol import RunFileError
from athrl_protocol.run_file.document import read_document
from athrl_protocol.run_file.section import Section
from athrl_protocol.run_file.toml_values import show
from athrl_spaces import CASE_STUDIES, REFERENCE_DRIVERS
from athrl_spaces.untrusted import one_line
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, field_validator, model_validator

from athrl.errors import CommandError

SCORES = (
    "return_mean",
    "speed_mps",
    "distance_m",
    "collision_rate",
    "off_lane_rate",
    "full_episode_rate",
    "success_rate",
    "success_seconds",
    "driving_score",
)
"""Scores of `athrl evaluate` that a study keeps."""

MOST_RUNS = 10_000

MOST_IN_A_LIST = 500
"""Seeds, towns, settings, variants or ranges of a study."""

_NAME = r"^[a-z0-9][a-z0-9_-]{0,30}$"
_NAMES = "a name of at most 31 characters: a-z, 0-9, _ and -, not _ or - first"
"""What `_NAME` says."""


class StudyFileError(CommandError):
    """The file of a study is wrong: one line with the file, the key, its value and what it should be."""


def _not_twice(values: list[Any]) -> list[Any]:
    seen = set()
    for value in values:
        key = tuple(value) if isinstance(value, list) else value
        if key in seen:
            raise ValueError(f"{show(value)} appears twice, it should appear once")
        seen.add(key)
    return values


def _lists(least: int = 1) -> Any:
    """Bounds of a list that each run, or each seed of it, repeats."""
    return Field(min_length=least, max_length=MOST_IN_A_LIST)


Seeds = Annotated[list[Annotated[int, Field(ge=0, lt=2**31)]], _lists(), AfterValidator(_not_twice)]
Names = Annotated[list[Annotated[str, Field(min_length=1)]], _lists(), AfterValidator(_not_twice)]
Overrides = Annotated[list[str], _lists(0)]
"""Settings as after `--set`."""
Together = Annotated[Names, BeforeValidator(lambda given: [given] if isinstance(given, str) else given)]
"""Towns that one run drives in; one alone needs no brackets."""


class StudySection(Section):
    """`[study]`: what holds for all runs."""

    name: str = Field(pattern=_NAME)
    title: str = ""
    seeds: Seeds = Field(default=[1, 2, 3])
    settings: Overrides = Field(default=[])
    """Of every run."""
    drivers: Annotated[list[str], AfterValidator(_not_twice)] = Field(default=[])
    """Reference drivers that are scored beside the policies in each town."""
    hours_a_run: float = Field(default=48.0, gt=0.0, le=1000.0)
    """Limit of one run; beyond it the run has failed."""

    @field_validator("drivers")
    @classmethod
    def _known(cls, drivers: list[str]) -> list[str]:
        for driver in drivers:
            if driver not in REFERENCE_DRIVERS:
                raise ValueError(f"{show(driver)} is no driver, it should be {', '.join(REFERENCE_DRIVERS)}")
        return drivers


class ScoringSection(Section):
    """`[scoring]`: the episodes that every last policy drives greedily, of seeds on which no run trains."""

    episodes: int = Field(default=100, ge=2, le=100_000)
    first_seed: int = Field(default=700_000, ge=0, lt=2**31)


class GridSection(Section):
    """`[[grid]]`: every planner in every town, in every variant, with every seed."""

    planners: Names
    towns: Annotated[list[Together], _lists(), AfterValidator(_not_twice)]
    seeds: Seeds | None = None
    run_file: str | None = None
    """Path from the study's file; `{planner}` and `{town}` stand for those of the run."""
    settings: Overrides = Field(default=[])
    variants: Annotated[dict[str, Overrides], _lists()] = Field(default={"": []})
    """Further overrides by the name of the variant."""

    @field_validator("run_file")
    @classmethod
    def _can_be_filled(cls, template: str | None) -> str | None:
        if template is not None and set("{}") & set(filled(template, planner="", town="")):
            raise ValueError(
                f"{show(template)}: should be a path that has {{planner}} and {{town}} alone in braces"
            )
        return template


class ElsewhereSection(Section):
    """`[[elsewhere]]`: a place where every last policy is scored, too: a town or a case study."""

    name: str = Field(pattern=_NAME)
    town: str | None = None
    case_study: str | None = None
    vehicles: int | None = Field(default=None, ge=0)
    """Background vehicles; by default the run's."""
    episodes: int | None = Field(default=None, ge=2, le=100_000)
    """By default as many as at home."""

    @field_validator("case_study")
    @classmethod
    def _exists(cls, case_study: str | None) -> str | None:
        if case_study is not None and case_study not in CASE_STUDIES:
            raise ValueError(f"{show(case_study)} is no case study, it should be {', '.join(CASE_STUDIES)}")
        return case_study

    @model_validator(mode="after")
    def _is_one_place(self) -> ElsewhereSection:
        if (self.town is None) == (self.case_study is None):
            raise ValueError(f"{show(self.name)} should have a town or a case_study, one of the two")
        if self.case_study is not None and self.vehicles is not None:
            raise ValueError(f"{show(self.name)}: a case study has its own vehicles, leave vehicles out")
        return self


class PublishedSection(Section):
    """`[[published]]`: training averages that somebody else published for a planner in a town."""

    planner: str
    town: str
    return_mean: float | None = None
    speed_mps: float | None = None


class Range(Section):
    """Bounds of a number in a search; two integers make it an integer."""

    low: int | float
    high: int | float
    log: bool = False

    @model_validator(mode="after")
    def _is_a_range(self) -> Range:
        if not self.low < self.high:
            raise ValueError(f"low is {self.low} and high is {self.high}: low should be less")
        if self.log and self.low <= 0:
            raise ValueError(f"low is {self.low}: on a logarithmic scale it should be above 0")
        return self


class SearchSection(Section):
    """`[search]`: over which settings, for what and how often."""

    trials: int = Field(ge=1, le=100_000)
    objective: Literal[SCORES] = "return_mean"  # type: ignore[valid-type]
    direction: Literal["maximise", "minimise"] = "maximise"
    prune: bool = True
    """Whether a trial whose scores on the way are below the median of the earlier ones is ended."""
    ranges: Annotated[dict[str, Range | Annotated[list[bool | int | float | str], _lists()]], _lists()]


class StudyFile(Section):
    """The whole file."""

    study: StudySection
    scoring: ScoringSection = ScoringSection()
    grid: list[GridSection] = Field(min_length=1)
    elsewhere: list[ElsewhereSection] = Field(default=[])
    published: list[PublishedSection] = Field(default=[])
    search: SearchSection | None = None


def read_study_file(path: Path) -> StudyFile:
    """Read and validate the file of a study, without its runs' settings.

    Raises:
        StudyFileError: it cannot be read, is no TOML, or has a wrong key or value.
    """
    try:
        values = read_document(path)
    except RunFileError as error:
        raise StudyFileError(str(error)) from None
    try:
        return StudyFile.model_validate(values)
    except ValidationError as error:
        raise StudyFileError(f"{path}: {_describe(error)}") from None


def filled(template: str, *, planner: str, town: str) -> str:
    """Return the path of a run file for a planner and a town."""
    return template.replace("{planner}", planner).replace("{town}", town)


def numbered(table: str, index: int) -> str:
    """Return how an error names one of several tables, or values, counted from 1."""
    return f"{table} number {index + 1}"


def _key(parts: Sequence[int | str]) -> str:
    """Return where something is in the file, such as `grid number 2, towns number 1`."""
    key = ""
    for before, part in zip(("", *parts), parts, strict=False):
        if isinstance(part, int):
            key = numbered(key, part)
        else:
            key += f"{', ' if isinstance(before, int) else '.' if key else ''}{part}"
    return key


def _describe(error: ValidationError) -> str:
    """Return the first fault: the key, its value unless it is missing, and what it should be."""
    detail = error.errors(include_url=False)[0]
    key = _key(detail["loc"]) or "the file"
    match detail["type"]:
        case "missing":
            return f"{key} is missing"
        case "extra_forbidden":
            return f"{key} is no key of a study"
        case "value_error" | "assertion_error":
            return one_line(f"{key}: {detail['msg'].partition(', ')[2]}")
        case "string_pattern_mismatch":
            return one_line(f"{key} = {show(detail['input'])}: should be {_NAMES}")
        case _:
            should = detail["msg"].removeprefix("Input ")
            return one_line(f"{key} = {show(detail['input'])}: {should}")
