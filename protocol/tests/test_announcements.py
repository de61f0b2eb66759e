"""The newest value reaches all subscribers, early or late, and never an older one after it."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest
import zenoh
from athrl_protocol import (
    LatestPublisher,
    LatestSubscriber,
    PolicyPublisher,
    PolicySubscriber,
    PolicyUpdate,
    new_incarnation,
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


def test_made_up_keys_take_no_memory_and_push_out_no_living_publisher(
    listen: Open, connect: Open, eventually: Eventually, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("athrl_protocol.announcements.latest_value.MOST_KEYS", 3)
    learner, seen = listen(), []
    with (
        LatestSubscriber(connect(), f"{KEY}/*", seen.append) as subscriber,
        LatestPublisher(learner, f"{KEY}/lives") as living,
    ):
        living.publish(b"lives")
        for number in range(10):
            with LatestPublisher(learner, f"{KEY}/{number}") as publisher:
                publisher.publish(b"%d" % number)
                eventually(lambda: seen[-1:] == [b"%d" % number])  # noqa: B023 (called at once)
            eventually(lambda: f"{KEY}/{number}" in subscriber._without_publisher)  # noqa: B023
        assert len(subscriber._versions) == 3
        assert f"{KEY}/lives" in subscriber._versions
        assert subscriber._without_publisher < subscriber._versions.keys()


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
