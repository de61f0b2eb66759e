"""Policies, states and scores arrive whole, also at those who come late."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable

import zenoh
from athrl_protocol import (
    EvaluationPublisher,
    EvaluationResult,
    EvaluationSubscriber,
    Keys,
    LatestPublisher,
    LatestSubscriber,
    Phase,
    PolicyPublisher,
    PolicySubscriber,
    PolicyUpdate,
    RunState,
    StatePublisher,
    StateSubscriber,
)
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.schema import encode_message

PATIENCE = 30.0
RUN = "announcements"
Open = Callable[[], zenoh.Session]
Eventually = Callable[[Callable[[], bool]], None]


def _policy(version: int, artefact: bytes = b"onnx") -> PolicyUpdate:
    return PolicyUpdate(
        version=version,
        artefact=artefact,
        uniform_exploration=version == 0,
        noise_scale=0.5,
        updates=10 * version,
        environment_steps=100 * version,
        published_at=1.5e9,
    )


def test_policy_that_arrived_damaged_is_not_used(listen: Open, connect: Open, eventually: Eventually) -> None:
    with (
        LatestPublisher(listen(), Keys(RUN).policy) as publisher,
        PolicySubscriber(connect(), RUN) as subscriber,
    ):
        right = hashlib.sha256(b"onnx").digest()
        for message in (
            athrl_pb2.Policy(version=1, artefact=b"onnx", sha256=right),
            athrl_pb2.Policy(version=2, artefact=b"onno", sha256=right),
            athrl_pb2.Policy(version=3, artefact=b"onnx", sha256=right, noise_scale=float("nan")),
        ):
            publisher.publish(encode_message(message))
        publisher.publish(b"rubbish")
        publisher.publish(encode_message(athrl_pb2.Policy(version=4, artefact=b"onnx", sha256=right)))
        eventually(lambda: (subscriber.newest() or _policy(0)).version == 4)


def test_damaged_newest_leaves_the_one_before(listen: Open, connect: Open) -> None:
    seen: list[PolicyUpdate] = []
    damaged = threading.Event()
    with LatestPublisher(listen(), Keys(RUN).policy) as publisher:
        session = connect()
        with (
            PolicySubscriber(session, RUN, seen.append) as subscriber,
            LatestSubscriber(
                session, Keys(RUN).policy, lambda value: damaged.set() if value == b"bad" else None
            ),
        ):
            digest = hashlib.sha256(b"onnx").digest()
            publisher.publish(encode_message(athrl_pb2.Policy(version=1, artefact=b"onnx", sha256=digest)))
            assert subscriber.wait(PATIENCE) is not None
            publisher.publish(b"bad")
            assert damaged.wait(PATIENCE)
            newest = subscriber.newest()
            assert newest is not None
            assert newest.version == 1
    assert [policy.version for policy in seen] == [1]


def test_large_policy_reaches_several_subscribers(listen: Open, connect: Open) -> None:
    artefact = bytes(range(256)) * 2**14  # 4 MiB
    with PolicyPublisher(listen(), RUN) as publisher:
        subscribers = [PolicySubscriber(connect(), RUN) for _ in range(3)]
        publisher.publish(_policy(1, artefact))
        for subscriber in subscribers:
            assert subscriber.wait(PATIENCE) == _policy(1, artefact)
            subscriber.close()


def test_state_of_the_run_arrives_with_its_phase(listen: Open, connect: Open) -> None:
    state = RunState(Phase.TRAINING, 120, 40_000, 17, 3, "training waits for actors")
    with StatePublisher(listen(), RUN) as publisher, StateSubscriber(connect(), RUN) as subscriber:
        publisher.publish(state)
        assert subscriber.wait(PATIENCE) == state


def test_state_that_names_a_folder_with_strange_signs_arrives(listen: Open, connect: Open) -> None:
    waiting = f"the disk of /runs/a\u00a0b{'/folder' * 500} is full"
    with StatePublisher(listen(), RUN) as publisher, StateSubscriber(connect(), RUN) as subscriber:
        publisher.publish(RunState(Phase.TRAINING, 120, 40_000, 17, 3, waiting))
        state = subscriber.wait(PATIENCE)
    assert state is not None
    assert state.waiting == waiting.replace("\u00a0", " ")[:2_000]


def test_latecomer_gets_the_newest_result_of_every_driver(
    listen: Open, connect: Open, eventually: Eventually
) -> None:
    listen()
    results = {
        (driver, version): EvaluationResult(
            driver, version, 100, "town03", 7, {"return_mean": float(version)}
        )
        for driver, version in (("policy", 1), ("policy", 2), ("random", 0), ("rule-based", 0))
    }
    seen: list[EvaluationResult] = []
    with EvaluationPublisher(connect(), RUN) as publisher:
        for result in results.values():
            publisher.publish(result)
        with EvaluationSubscriber(connect(), RUN, seen.append):
            eventually(lambda: len(seen) == 3)
    assert {(result.driver, result.policy_version) for result in seen} == {
        ("policy", 2),
        ("random", 0),
        ("rule-based", 0),
    }
    assert all(result == results[result.driver, result.policy_version] for result in seen)


def test_latecomer_gets_the_newest_result_of_every_town(
    listen: Open, connect: Open, eventually: Eventually
) -> None:
    listen()
    towns = ("town03", "town04", "maps/a b.xodr", "other/a b.xodr", "a_b.xodr", "ä" * 200 + ".xodr")
    seen: list[EvaluationResult] = []
    with EvaluationPublisher(connect(), RUN) as publisher:
        for version in (1, 2):
            for town in towns:
                publisher.publish(EvaluationResult("policy", version, 100, town, 7, {"return_mean": 1.0}))
        with EvaluationSubscriber(connect(), RUN, seen.append):
            eventually(lambda: len(seen) == len(towns))
    assert {(result.town, result.policy_version) for result in seen} == {(town, 2) for town in towns}


def test_two_evaluators_do_not_silence_each_other(
    listen: Open, connect: Open, eventually: Eventually
) -> None:
    listen()
    seen: list[EvaluationResult] = []
    with (
        EvaluationSubscriber(connect(), RUN, seen.append),
        EvaluationPublisher(connect(), RUN, "first") as first,
        EvaluationPublisher(connect(), RUN, "second") as second,
    ):
        for version, publisher in enumerate((first, second, first, second, first)):
            publisher.publish(EvaluationResult("policy", version, 0, "town03", 0, {}))
            eventually(lambda version=version: len(seen) == version + 1)
