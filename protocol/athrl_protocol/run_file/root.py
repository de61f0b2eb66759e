"""The run file as a whole: its sections together and what must hold between them."""

from __future__ import annotations

from typing import Self

from pydantic import ValidationError, model_validator

from athrl_protocol.chunk import MAXIMUM_TIME
from athrl_protocol.errors import RunFileError
from athrl_protocol.run_file.sections import (
    ActorSection,
    DurabilitySection,
    EnvironmentSection,
    EvaluatorSection,
    ExplorationSection,
    LearnerSection,
    NetworkSection,
    PlannerSection,
    ReplaySection,
    RunSection,
    Section,
    SerialSection,
)


class RunFile(Section):
    """All settings of a run; `RunFile()` has every default. Immutable."""

    run: RunSection = RunSection()
    environment: EnvironmentSection = EnvironmentSection()
    planner: PlannerSection = PlannerSection()
    exploration: ExplorationSection = ExplorationSection()
    replay: ReplaySection = ReplaySection()
    learner: LearnerSection = LearnerSection()
    durability: DurabilitySection = DurabilitySection()
    actor: ActorSection = ActorSection()
    evaluator: EvaluatorSection = EvaluatorSection()
    serial: SerialSection = SerialSection()
    network: NetworkSection = NetworkSection()

    @model_validator(mode="after")
    def _check_sections_against_each_other(self) -> Self:
        length = self.replay.sequence_length
        if self.replay.burn_in >= length:
            raise ValueError(
                f"replay.burn_in = {self.replay.burn_in}: should be less than "
                f"replay.sequence_length = {length}"
            )
        if self.replay.capacity < self.learner.batch * length:
            raise ValueError(
                f"replay.capacity = {self.replay.capacity}: should be at least learner.batch x "
                f"replay.sequence_length = {self.learner.batch * length}, one batch"
            )
        if self.environment.episode_ticks < self.environment.ticks_per_decision:
            raise ValueError(
                f"environment.episode_ticks = {self.environment.episode_ticks}: should be at least "
                f"environment.ticks_per_decision = {self.environment.ticks_per_decision}"
            )
        if self.exploration.random_decisions >= self.run.environment_steps:
            raise ValueError(
                f"exploration.random_decisions = {self.exploration.random_decisions}: should be less than "
                f"run.environment_steps = {self.run.environment_steps}, or nothing is trained"
            )
        return self

    @property
    def longest_chunk(self) -> int:
        """Decisions in a chunk at most: whole sequences, as many as are wanted and a message may have."""
        length = self.replay.sequence_length
        return length * min(self.actor.sequences_per_chunk, MAXIMUM_TIME // length)

    def to_json(self) -> str:
        """Return all settings as JSON."""
        return self.model_dump_json()

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """Read what `to_json` wrote.

        Raises:
            RunFileError: it is not a valid run file of this release.
        """
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(str(part) for part in first["loc"]) or "run file"
            raise RunFileError(f"served run file: {place}: {first['msg']}") from None
