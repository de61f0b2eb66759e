"""The newest value reaches all subscribers, early or late, and never an older one after it."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable

import pytest
import zenoh
from athrl_protocol import (
    EvaluationPublisher,
    EvaluationResult,
    EvaluationSubscriber,
    Keys,
    LatestPublisher,
    LatestSubscriber,
    LearnerNotFound,
    Phase,
    PolicyPublisher,
    PolicySubscriber,
    PolicyUpdate,
    RunFile,
    RunNotFound,
    RunState,
    StatePublisher,
    StateSubscriber,
    fetch_run_file,
    new_incarnation,
    read_run_file,
    serve_run_file,
)
from athrl_protocol.announcements.typed import TypedSubscriber
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.schema import encode_message

PATIENCE = 30.0
RUN = "announcements"
KEY = "athrl/test/newest"
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


def _version(incarnation: int, number: int) -> bytes:
    return encode_message(athrl_pb2.Version(incarnation=incarnation, number=number))


def test_late_subscriber_has_the_newest_at_once(listen: Open, connect: Open) -> None:
    with LatestPublisher(listen(), KEY) as publisher:
        publisher.publish(b"one")
        publisher.publish(b"two")
        for _ in range(2):  # a restarted subscriber too
            with TypedSubscriber(connect(), KEY, bytes) as subscriber:
                assert subscriber.wait(PATIENCE) == b"two"


def test_early_subscriber_gets_values_in_order_up_to_the_newest(
    listen: Open, connect: Open, eventually: Eventually
) -> None:
    learner = listen()
    seen: list[bytes] = []
    with LatestSubscriber(connect(), KEY, seen.append), LatestPublisher(learner, KEY) as publisher:
        publisher.publish(b"first")
        eventually(lambda: bool(seen))
        for number in range(20):
            publisher.publish(b"%d" % number)
        eventually(lambda: seen[-1] == b"19")
    # Not each of them, where the answer to its first question overtakes some.
    numbers = [int(value) for value in seen[1:]]
    assert numbers == sorted(set(numbers))


def test_subscriber_returns_without_a_value_when_there_is_none(listen: Open, connect: Open) -> None:
    with LatestPublisher(listen(), KEY), TypedSubscriber(connect(), KEY, bytes) as subscriber:
        assert subscriber.wait(0.05) is None
        assert subscriber.newest() is None


def test_value_whose_put_was_lost_comes_after_a_reminder_and_is_asked_for_once(
    listen: Open, connect: Open, eventually: Eventually, monkeypatch: pytest.MonkeyPatch
) -> None:
    learner, seen, asked, answered = listen(), [], [], []
    query_first = LatestSubscriber._query
    monkeypatch.setattr(LatestSubscriber, "_query", lambda *given: (query_first(*given), answered.append(1)))
    with (
        LatestSubscriber(connect(), KEY, seen.append) as subscriber,
        LatestPublisher(learner, KEY, 0.02) as publisher,
    ):
        publisher.publish(b"first")
        eventually(lambda: seen == [b"first"])
        eventually(lambda: bool(answered))  # else that answer might bring the second value
        monkeypatch.setattr(subscriber, "ask", lambda ask=subscriber.ask: (asked.append(1), ask()))
        lossy = type("", (), {"put": lambda *_, **__: None, "undeclare": publisher._publisher.undeclare})()
        monkeypatch.setattr(publisher, "_publisher", lossy)
        publisher.publish(b"second")
        eventually(lambda: seen == [b"first", b"second"])
    assert len(asked) == 1


def test_reminder_of_what_is_known_or_older_asks_for_nothing(
    listen: Open, connect: Open, eventually: Eventually
) -> None:
    learner, values, seen = listen(), [], []
    known, came = threading.Event(), threading.Event()

    class Quiet(LatestSubscriber):
        knew = False  # a subscriber that gets a reminder before the value queries it

        def ask(self) -> None:
            assert not self.knew, "there is nothing to ask for"

        def _request_missed(self, key: str, version: object) -> None:
            self.knew = known.is_set()
            super()._request_missed(key, version)  # type: ignore[arg-type]
            if self.knew:
                seen.append(version)
            if len(seen) == 3:
                came.set()

    with LatestPublisher(learner, KEY, 0.02) as publisher:
        publisher.publish(b"value")
        with Quiet(connect(), KEY, values.append) as subscriber:
            eventually(lambda: values == [b"value"])
            known.set()
            assert came.wait(PATIENCE)
            subscriber.check()


def test_older_value_never_follows_a_newer_one(listen: Open, connect: Open, eventually: Eventually) -> None:
    learner = listen()
    seen: list[bytes] = []
    present = new_incarnation()
    with LatestSubscriber(connect(), KEY, seen.append):
        eventually(lambda: _matches(learner, KEY))
        for incarnation, number, value in (
            (present, 5, b"new"),
            (present, 5, b"the same again"),
            (present, 4, b"late"),
            (present - 1, 99, b"of the learner before"),
            (present, 6, b"newer"),
            (present + 1, 1, b"of the learner after"),
            (present, 7, b"of the learner before again"),
            (present + 1, 2, b"last"),
        ):
            learner.put(KEY, value, attachment=_version(incarnation, number))
        learner.put(KEY, b"nothing that says its version")
        learner.put(
            KEY, b"of another schema", attachment=athrl_pb2.Version(incarnation=2**63).SerializeToString()
        )
        learner.put(KEY, b"end", attachment=_version(present + 1, 3))
        eventually(lambda: bool(seen) and seen[-1] == b"end")
    assert seen == [b"new", b"newer", b"of the learner after", b"last", b"end"]


def test_version_from_the_future_is_refused_by_name_and_blocks_nothing(
    listen: Open, connect: Open, eventually: Eventually, caplog: pytest.LogCaptureFixture
) -> None:
    learner = listen()
    present = new_incarnation()
    week = 7 * 86_400 * 10**9
    with TypedSubscriber(connect(), KEY, bytes) as subscriber:
        eventually(lambda: _matches(learner, KEY))
        for incarnation in (2**64 - 2, present + week):
            learner.put(KEY, b"forged", attachment=_version(incarnation, 1))
        learner.put(KEY, b"true", attachment=_version(present, 1))
        assert subscriber.wait(PATIENCE) == b"true"
    refusals = [record.getMessage() for record in caplog.records]
    assert len(refusals) == 2
    for refusal, incarnation in zip(refusals, (2**64 - 2, present + week), strict=True):
        assert f"value under {KEY}" in refusal
        assert f"incarnation {incarnation} begins at" in refusal


def _matches(session: zenoh.Session, key: str) -> bool:
    publisher = session.declare_publisher(key)
    try:
        return publisher.matching_status.matching
    finally:
        publisher.undeclare()


def test_learner_that_returns_with_lower_versions_is_heard_at_once(listen: Open, connect: Open) -> None:
    learner = listen()
    arrived = threading.Semaphore(0)
    with PolicyPublisher(learner, RUN) as publisher:
        publisher.publish(_policy(9))
        actor = connect()
        subscriber = PolicySubscriber(actor, RUN, lambda _: arrived.release())
        assert arrived.acquire(timeout=PATIENCE)
        assert subscriber.newest() == _policy(9)
    learner.close()
    with subscriber, PolicyPublisher(listen(), RUN) as publisher:
        publisher.publish(_policy(4))
        assert arrived.acquire(timeout=PATIENCE)
        assert subscriber.newest() == _policy(4)


def test_learner_that_returns_with_a_clock_set_back_is_heard(
    listen: Open, connect: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    learner = listen()
    publisher = LatestPublisher(learner, KEY)
    publisher.publish(b"before")
    arrived = threading.Semaphore(0)
    with TypedSubscriber(connect(), KEY, bytes, lambda _: arrived.release()) as subscriber:
        assert arrived.acquire(timeout=PATIENCE)
        publisher.close()
        learner.close()
        monkeypatch.setattr("athrl_protocol.announcements.latest_value.new_incarnation", lambda: 1)
        with LatestPublisher(listen(), KEY) as returned:
            returned.publish(b"after")
            assert arrived.acquire(timeout=PATIENCE)
            assert subscriber.newest() == b"after"


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


def test_actor_starts_with_an_address_and_a_run_name_only(listen: Open, connect: Open) -> None:
    run_file = read_run_file(None, [f"run.name={RUN}", "learner.batch=5"])
    with serve_run_file(listen(), run_file):
        assert fetch_run_file(connect(), RUN, PATIENCE) == run_file


def test_run_that_does_not_exist_is_answered_with_those_that_do(
    listen: Open, connect: Open, address: str
) -> None:
    with serve_run_file(listen(), RunFile()), pytest.raises(RunNotFound) as caught:
        fetch_run_file(connect(), "town05", 0.2)
    assert str(caught.value) == f"no run 'town05' at {address}: name one of those it has, town03"


def test_the_only_run_needs_no_name_and_several_do(listen: Open, connect: Open) -> None:
    learner, session = listen(), connect()
    other = read_run_file(None, ["run.name=other"])
    with serve_run_file(learner, RunFile()):
        assert fetch_run_file(session, None, PATIENCE) == RunFile()
        with serve_run_file(learner, other), pytest.raises(RunNotFound, match="name one of other, town03"):
            fetch_run_file(session, None, PATIENCE)


def test_learner_that_serves_nothing_is_named_after_the_timeout(
    listen: Open, connect: Open, address: str
) -> None:
    listen()
    with pytest.raises(LearnerNotFound, match=f"no learner serves run 'town03' at {address} within 0.3 s"):
        fetch_run_file(connect(), "town03", 0.3)


def test_run_file_that_comes_late_is_waited_for(listen: Open, connect: Open) -> None:
    learner = listen()
    served: list[LatestPublisher] = []
    timer = threading.Timer(0.3, lambda: served.append(serve_run_file(learner, RunFile())))
    timer.start()
    try:
        assert fetch_run_file(connect(), "town03", PATIENCE) == RunFile()
    finally:
        timer.join()
        served[0].close()
