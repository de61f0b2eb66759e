"""The complete run file: its sections and the checks between them."""

from __future__ import annotations

import math
from typing import Self

from athrl_spaces import CHANNELS
from athrl_spaces.untrusted import one_line, parser_errors
from pydantic import Field, ValidationError, ValidationInfo, model_validator

from athrl_protocol.errors import RunFileError
from athrl_protocol.messages.chunk import MAXIMUM_IMAGES_BYTES, MAXIMUM_TIME
from athrl_protocol.run_file.document import MOST_BYTES, check_document
from athrl_protocol.run_file.planner_tables import PlannerSection
from athrl_protocol.run_file.section import Section
from athrl_protocol.run_file.sections import (
    ActorSection,
    DurabilitySection,
    EnvironmentSection,
    EvaluatorSection,
    ExplorationSection,
    LearnerSection,
    MetricsSection,
    NetworkSection,
    ReplaySection,
    RunSection,
    SerialSection,
)


class RunFile(Section):
    """All settings of a run; `RunFile()` has every default. Immutable."""

    run: RunSection = RunSection()
    environment: EnvironmentSection = EnvironmentSection()
    planner: PlannerSection = Field(default_factory=PlannerSection)
    exploration: ExplorationSection = ExplorationSection()
    replay: ReplaySection = ReplaySection()
    learner: LearnerSection = LearnerSection()
    durability: DurabilitySection = DurabilitySection()
    actor: ActorSection = ActorSection()
    evaluator: EvaluatorSection = EvaluatorSection()
    serial: SerialSection = SerialSection()
    network: NetworkSection = NetworkSection()
    metrics: MetricsSection = MetricsSection()

    @model_validator(mode="after")
    def _check_sections_against_each_other(self, info: ValidationInfo) -> Self:
        environment = self.environment
        if environment.episode_ticks < environment.ticks_per_decision:
            raise ValueError(
                f"environment.episode_ticks = {environment.episode_ticks}: should be at least "
                f"environment.ticks_per_decision = {environment.ticks_per_decision}"
            )
        if (info.context or {}).get("training", True):
            self._check_sequences()
            self._check_training()
        return self

    def _check_sequences(self) -> None:
        length = self.replay.sequence_length
        if self.replay.burn_in >= length:
            raise ValueError(
                f"replay.burn_in = {self.replay.burn_in}: should be less than "
                f"replay.sequence_length = {length}"
            )
        if length > self.episode_decisions:
            raise ValueError(
                f"replay.sequence_length = {length}: should be at most {self.episode_decisions}, the "
                "decisions of an episode (environment.episode_ticks / environment.ticks_per_decision)"
            )
        if self._most_images <= length:
            raise ValueError(
                f"environment.image_size = {self.environment.image_size}: a sequence of "
                f"replay.sequence_length = {length} decisions has {length + 1} such images, should be at "
                f"most {self._most_images}, as a message may have {MAXIMUM_IMAGES_BYTES // 2**20} MiB of them"
            )

    def _check_training(self) -> None:
        least = max(self.learner.batch, self.replay.sequence_length)
        if self.replay.capacity < least:
            raise ValueError(
                f"replay.capacity = {self.replay.capacity}: should be at least {least}, which is one batch "
                f"(learner.batch = {self.learner.batch}) and one sequence "
                f"(replay.sequence_length = {self.replay.sequence_length})"
            )

    @property
    def episode_decisions(self) -> int:
        """Most decisions in an episode."""
        return math.ceil(self.environment.episode_ticks / self.environment.ticks_per_decision)

    @property
    def warm_up(self) -> int:
        """Random decisions before training starts: those of the settings, at most a third of the run."""
        return min(self.exploration.random_decisions, self.run.environment_steps // 3)

    @property
    def _most_images(self) -> int:
        """Most images of a chunk."""
        return MAXIMUM_IMAGES_BYTES // (self.environment.image_size**2 * len(CHANNELS))

    @property
    def longest_chunk(self) -> int:
        """Most decisions in a chunk: whole sequences, bounded by the settings and the size of a message."""
        length = self.replay.sequence_length
        fit = min(MAXIMUM_TIME, self._most_images - 1) // length
        return length * min(self.actor.sequences_per_chunk, fit)

    def to_json(self) -> str:
        """Return all settings as JSON."""
        return self.model_dump_json()

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """Read what `to_json` wrote.

        Raises:
            RunFileError: it is not a valid run file of this release.
        """
        if len(text) > MOST_BYTES:
            raise RunFileError(f"served run file: is too large: should have at most {MOST_BYTES:,} bytes")
        with parser_errors(lambda reason: RunFileError(f"served run file: {reason}")):
            run_file = cls._validated(text)
            check_document(run_file.model_dump(), "served run file: ")
        return run_file

    @classmethod
    def _validated(cls, text: str | bytes) -> Self:
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(str(part) for part in first["loc"]) or "run file"
            reason = first["msg"].removeprefix("Value error, ")
            raise RunFileError(f"served run file: {one_line(f'{place}: {reason}')}") from None
