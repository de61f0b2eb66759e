"""The newest policy: learner to actors and evaluators."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass

import zenoh

from athrl_protocol.announcements.typed import TypedPublisher, TypedSubscriber
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.keys import Keys
from athrl_protocol.messages.limits import LARGEST_POLICY
from athrl_protocol.messages.schema import check_counts, decode_message, encode_message

REMIND_SECONDS = 0.5
"""Seconds between reminders, so that an actor that missed a policy has it within a second."""


@dataclass(frozen=True)
class PolicyUpdate:
    """A published policy.

    Attributes:
        version: grows with each publication; after a restart of the learner it may continue at a lower
            number.
        artefact: the ONNX file.
        uniform_exploration: actors draw actions uniformly (the warm-up).
        noise_scale: factor on the artefact's exploration noise.
        updates: of the planner when it was published.
        environment_steps: accepted when it was published.
        published_at: unix seconds.
    """

    version: int
    artefact: bytes
    uniform_exploration: bool
    noise_scale: float
    updates: int
    environment_steps: int
    published_at: float


def _encode(update: PolicyUpdate) -> bytes:
    return encode_message(
        athrl_pb2.Policy(
            version=update.version,
            artefact=update.artefact,
            sha256=hashlib.sha256(update.artefact).digest(),
            uniform_exploration=update.uniform_exploration,
            noise_scale=update.noise_scale,
            updates=update.updates,
            environment_steps=update.environment_steps,
            published_at=update.published_at,
        )
    )


def _decode(payload: bytes) -> PolicyUpdate:
    message = decode_message(athrl_pb2.Policy, payload, largest=LARGEST_POLICY)
    check_counts(
        "policy",
        version=message.version,
        updates=message.updates,
        environment_steps=message.environment_steps,
    )
    if hashlib.sha256(message.artefact).digest() != message.sha256:
        raise InvalidMessage("checksum", f"policy {message.version}: its artefact arrived damaged")
    if not (math.isfinite(message.noise_scale) and message.noise_scale >= 0):
        raise InvalidMessage(
            "value", f"policy {message.version}: noise scale {message.noise_scale}, should be >= 0"
        )
    return PolicyUpdate(
        version=message.version,
        artefact=message.artefact,
        uniform_exploration=message.uniform_exploration,
        noise_scale=message.noise_scale,
        updates=message.updates,
        environment_steps=message.environment_steps,
        published_at=message.published_at,
    )


class PolicyPublisher(TypedPublisher[PolicyUpdate]):
    """Publishes policies, used by the learner."""

    def __init__(self, session: zenoh.Session, run: str) -> None:
        super().__init__(session, Keys(run).policy, _encode, REMIND_SECONDS)


class PolicySubscriber(TypedSubscriber[PolicyUpdate]):
    """Keeps the newest policy whose checksum is right."""

    def __init__(
        self, session: zenoh.Session, run: str, on_value: Callable[[PolicyUpdate], None] | None = None
    ) -> None:
        super().__init__(session, Keys(run).policy, _decode, on_value)
