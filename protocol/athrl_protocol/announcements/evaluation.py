"""Results of evaluations; late subscribers get the newest result of each driver in each town."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import zenoh

from athrl_protocol.announcements.typed import TypedPublisher, TypedSubscriber
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.keys import Keys
from athrl_protocol.messages.limits import LARGEST_NUMBERS
from athrl_protocol.messages.schema import (
    check_counts,
    check_numbers,
    check_text,
    decode_message,
    encode_message,
)
from athrl_protocol.transport.closeable import Closeable


@dataclass(frozen=True)
class EvaluationResult:
    """The scores of one driver over a set of episodes.

    Attributes:
        driver: policy, random, blind or rule-based.
        policy_version: version of the policy, 0 for other drivers.
        environment_steps: of the run when the policy was published.
        town: where the episodes were driven.
        seed: of the first episode.
        scores: by the score's name, as `athrl evaluate --json` prints them.
    """

    driver: str
    policy_version: int
    environment_steps: int
    town: str
    seed: int
    scores: dict[str, float]


def _encode(result: EvaluationResult) -> bytes:
    return encode_message(
        athrl_pb2.Evaluation(
            driver=result.driver,
            policy_version=result.policy_version,
            environment_steps=result.environment_steps,
            town=result.town,
            seed=result.seed,
            scores=result.scores,
        )
    )


def _decode(payload: bytes) -> EvaluationResult:
    message = decode_message(athrl_pb2.Evaluation, payload, largest=LARGEST_NUMBERS)
    check_numbers("evaluation", message.scores)
    check_counts(
        "evaluation", policy_version=message.policy_version, environment_steps=message.environment_steps
    )
    for kind, text in (("driver", message.driver), ("town", message.town)):
        check_text("evaluation", kind, text)
    return EvaluationResult(
        driver=message.driver,
        policy_version=message.policy_version,
        environment_steps=message.environment_steps,
        town=message.town,
        seed=message.seed,
        scores=dict(message.scores),
    )


class EvaluationPublisher(Closeable):
    """Publishes results, used by an evaluator.

    Args:
        session: an open session.
        run: name of the run.
        name: name of the evaluator, so that two evaluators do not replace each other's results.
    """

    def __init__(self, session: zenoh.Session, run: str, name: str = "evaluator") -> None:
        self._session = session
        self._keys = Keys(run)
        self._name = name
        self._publishers: dict[tuple[str, str], TypedPublisher[EvaluationResult]] = {}

    def publish(self, result: EvaluationResult) -> None:
        """Make `result` the newest of its driver in its town and send it to all subscribers."""
        which = result.driver, result.town
        if which not in self._publishers:
            key = self._keys.evaluation(self._name, *which)
            self._publishers[which] = TypedPublisher(self._session, key, _encode)
        self._publishers[which].publish(result)

    def close(self) -> None:
        """Stop publishing; late subscribers get no answer any more."""
        for publisher in self._publishers.values():
            publisher.close()


class EvaluationSubscriber(TypedSubscriber[EvaluationResult]):
    """Receives the results of all evaluators; `newest` is the last that arrived."""

    def __init__(
        self, session: zenoh.Session, run: str, on_value: Callable[[EvaluationResult], None] | None = None
    ) -> None:
        super().__init__(session, Keys(run).every_evaluation, _decode, on_value)
