"""An actor drives with the newest policy, requests one that did not arrive, and waits if it lags too far."""

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from athrl_actor import run_actor
from athrl_actor.policy_lag import ASK_SECONDS, PolicyLag
from athrl_protocol import Phase, RunState


@pytest.fixture
def driving(learner: Any) -> Iterator[Callable[[], None]]:
    """Start an actor, which is stopped after the test."""
    stop = threading.Event()
    threads: list[threading.Thread] = []

    def start() -> None:
        arguments = {"connect": learner.address, "run": "test", "name": "one", "stop": stop}
        threads.append(threading.Thread(target=run_actor, kwargs=arguments, daemon=True))
        threads[-1].start()

    yield start
    stop.set()
    for thread in threads:
        thread.join(60)
        assert not thread.is_alive()


def announce(learner: Any, version: int) -> None:
    """Announce a version in the run's state."""
    learner.states.publish(RunState(Phase.TRAINING, 1, 1000, 1, version))


def lose_what_is_put(learner: Any, monkeypatch: pytest.MonkeyPatch, *, reminders: bool) -> None:
    """Lose published policies, and their `reminders` if set; requests for a policy are still answered."""
    newest = learner.policies._publisher

    class Lossy:
        def put(self, payload: bytes, attachment: bytes) -> None:
            pass

        def undeclare(self) -> None:
            pass

    for name in ["_publisher", *(["_reminders"] if reminders else [])]:
        getattr(newest, name).undeclare()
        monkeypatch.setattr(newest, name, Lossy())


def last(learner: Any) -> dict[str, float]:
    return learner.reports[-1].values if learner.reports else {}


def test_policy_that_was_lost_on_its_way_is_asked_for(learner, driving, monkeypatch) -> None:
    learner.publish(1)
    driving()
    learner.wait_for_chunks(2)
    lose_what_is_put(learner, monkeypatch, reminders=True)
    learner.publish(2)
    learner.wait_for_chunks(len(learner.chunks) + 4)
    assert learner.chunks[-1].policy_version[0] == 1
    announce(learner, 2)
    assert learner.wait_for(lambda: learner.chunks[-1].policy_version[0] == 2)


def test_policy_whose_put_was_lost_arrives_soon_without_another_announcement(
    learner, driving, monkeypatch
) -> None:
    learner.publish(1)
    driving()
    learner.wait_for_chunks(2)
    lose_what_is_put(learner, monkeypatch, reminders=False)
    for version in (2, 3):
        learner.publish(version)
        assert learner.wait_for(lambda wanted=version: learner.chunks[-1].policy_version[-1] == wanted, 30)
    versions = [int(version) for chunk in learner.chunks for version in chunk.policy_version[: chunk.length]]
    assert set(versions) == {1, 2, 3}


def test_actor_too_far_behind_waits_and_continues_with_a_newer_policy(learner, driving, caplog) -> None:
    learner.publish(1)
    driving()
    learner.wait_for_chunks(2)
    announce(learner, 1 + learner.run_file.actor.policy_lag_versions)
    assert learner.wait_for(lambda: last(learner).get("policy_lag_versions") == 30)
    assert learner.wait_for(lambda: last(learner)["policy_lag_seconds"] > 0)
    before = len(learner.chunks)
    learner.wait_for_chunks(before + 4)  # as far as it may be behind: it drives
    announce(learner, 32)
    assert learner.wait_for(lambda: "waiting for a newer policy: version 1 decides" in caplog.text)
    assert learner.wait_for(lambda: last(learner)["policy_lag_versions"] == 31)
    assert learner.wait_for(lambda: last(learner)["chunks_waiting"] == 0)
    before, reports = len(learner.chunks), len(learner.reports)
    assert learner.wait_for(lambda: len(learner.reports) >= reports + 3)  # it lives, and does not drive
    assert len(learner.chunks) == before
    assert last(learner)["policy_lag_seconds"] > 1
    learner.publish(32)
    learner.wait_for_chunks(before + 4)
    assert learner.chunks[-1].policy_version[0] == 32
    assert "continuing with policy 32" in caplog.text
    assert learner.wait_for(lambda: last(learner)["policy_lag_versions"] == 0)


def test_waiting_actor_gets_the_policy_although_the_learner_publishes_no_other(
    learner, driving, monkeypatch
) -> None:
    """A learner that waits for this actor's experience makes no updates and publishes nothing."""
    learner.publish(1)
    driving()
    learner.wait_for_chunks(2)
    lose_what_is_put(learner, monkeypatch, reminders=True)
    learner.publish(99)
    announce(learner, 99)
    assert learner.wait_for(lambda: learner.chunks[-1].policy_version[0] == 99)


def test_learner_that_went_back_to_an_older_checkpoint_is_followed_at_once(learner, driving) -> None:
    learner.publish(500)
    announce(learner, 500)
    driving()
    learner.wait_for_chunks(2)
    learner.close()
    learner.open()
    learner.publish(3)  # its folder has no newer ones
    announce(learner, 3)
    assert learner.wait_for(lambda: learner.chunks[-1].policy_version[0] == 3)
    versions = [int(version) for chunk in learner.chunks for version in chunk.policy_version[: chunk.length]]
    assert set(versions) == {500, 3}
    assert learner.wait_for(lambda: last(learner).get("policy_lag_versions") == 0)


def test_newest_version_is_asked_for_once_a_second_at_most_and_only_when_it_is_late() -> None:
    now, asked = 0.0, []
    lag = PolicyLag(10, lambda: asked.append(now), clock=lambda: now)
    for _ in range(40):
        assert lag.update(7, 7)
        now += 0.1
    assert asked == []
    for _ in range(40):
        assert lag.update(7, 9)
        now += 0.1
    assert 2 <= len(asked) <= 4
    assert asked[0] - 4.0 >= ASK_SECONDS
    assert (lag.versions, round(lag.seconds)) == (2, 4)
    assert not lag.update(7, 18)
    assert lag.update(18, 18)
    assert lag.seconds == 0
    assert lag.update(18, 4)  # a learner that has gone back is not ahead
