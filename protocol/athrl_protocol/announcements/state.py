"""The state of a run: from the learner to all services, each second."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import zenoh
from athrl_spaces.untrusted import one_line

from athrl_protocol.announcements.typed import TypedPublisher, TypedSubscriber
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.keys import Keys
from athrl_protocol.messages.limits import LARGEST_NUMBERS
from athrl_protocol.messages.schema import check_counts, check_text, decode_message, encode_message

LONGEST_WAITING = 2_000
"""Characters."""


class Phase(Enum):
    """Phase of a run."""

    WARMING_UP = athrl_pb2.RunState.WARMING_UP
    TRAINING = athrl_pb2.RunState.TRAINING
    DRAINING = athrl_pb2.RunState.DRAINING
    FINISHED = athrl_pb2.RunState.FINISHED


@dataclass(frozen=True)
class RunState:
    """The state of a run.

    Attributes:
        phase: phase of the run; draining means that it was stopped early and can be resumed.
        environment_steps: decisions accepted so far.
        environment_steps_target: decisions at which the run ends.
        updates: of the planner so far.
        policy_version: the newest published one.
        waiting: which side waits for the other and why, in one line; empty if none does.
    """

    phase: Phase
    environment_steps: int
    environment_steps_target: int
    updates: int
    policy_version: int
    waiting: str = ""


def _encode(state: RunState) -> bytes:
    return encode_message(
        athrl_pb2.RunState(
            phase=state.phase.value,
            environment_steps=state.environment_steps,
            environment_steps_target=state.environment_steps_target,
            updates=state.updates,
            policy_version=state.policy_version,
            waiting=one_line(state.waiting)[:LONGEST_WAITING],  # it may name a folder of any name
        )
    )


def _decode(payload: bytes) -> RunState:
    message = decode_message(athrl_pb2.RunState, payload, largest=LARGEST_NUMBERS)
    check_text("run state", "waiting", message.waiting, LONGEST_WAITING)
    check_counts(
        "run state",
        environment_steps=message.environment_steps,
        environment_steps_target=message.environment_steps_target,
        updates=message.updates,
        policy_version=message.policy_version,
    )
    try:
        phase = Phase(message.phase)
    except ValueError:
        raise InvalidMessage("value", f"run state: phase {message.phase} is not known") from None
    return RunState(
        phase=phase,
        environment_steps=message.environment_steps,
        environment_steps_target=message.environment_steps_target,
        updates=message.updates,
        policy_version=message.policy_version,
        waiting=message.waiting,
    )


class StatePublisher(TypedPublisher[RunState]):
    """Publishes the run's state, used by the learner."""

    def __init__(self, session: zenoh.Session, run: str) -> None:
        super().__init__(session, Keys(run).state, _encode)


class StateSubscriber(TypedSubscriber[RunState]):
    """Keeps the newest state of the run."""

    def __init__(
        self, session: zenoh.Session, run: str, on_value: Callable[[RunState], None] | None = None
    ) -> None:
        super().__init__(session, Keys(run).state, _decode, on_value)
