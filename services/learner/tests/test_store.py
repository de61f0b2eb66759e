"""Intake and trainer meet in the store: who waits for whom, and when the run has all it needs."""

import threading

import pytest
from athrl_learner import translation
from athrl_learner.arrivals import Arrivals
from athrl_learner.store import ExperienceStore
from athrl_learner.waiting import WaitingTime, waiting_text
from athrl_protocol import IntakeBusy, IntakeFinished, InvalidMessage


@pytest.fixture
def store(run_file) -> ExperienceStore:
    agent = translation.make_agent(run_file)
    return ExperienceStore(
        translation.make_reader(run_file, agent),
        translation.make_replay(run_file, agent),
        translation.make_limiter(run_file),
        Arrivals(),
        run_file.run.environment_steps,
    )


def fill(store: ExperienceStore, make_chunk) -> None:
    """Insert until the store refuses."""
    while True:
        try:
            store.accept(make_chunk())
        except (IntakeBusy, IntakeFinished):
            return


def test_steps_are_counted_once_and_padding_never(store, make_chunk):
    store.accept(make_chunk(length=5))
    store.accept(make_chunk(length=2, terminated=True))
    assert store.environment_steps == store.limiter.inserts == len(store.replay) == 7


def test_a_refused_chunk_changes_nothing(store, make_chunk):
    with pytest.raises(InvalidMessage):
        store.accept(make_chunk(levels={}))
    assert store.environment_steps == store.limiter.inserts == len(store.replay) == 0


def test_actors_wait_while_training_lags(store, make_chunk):
    fill(store, make_chunk)
    before = store.environment_steps
    with pytest.raises(IntakeBusy, match="actors wait for the learner"):
        store.accept(make_chunk())
    assert store.environment_steps == before
    assert store.actors_waiting.share() > 0
    while store.sample(4, timeout=0) is not None:
        pass
    store.accept(make_chunk())
    assert store.environment_steps == before + 5


def test_training_waits_while_experience_lags(store, make_chunk):
    assert store.sample(4, timeout=0) is None
    fill(store, make_chunk)
    while store.sample(4, timeout=0) is not None:
        pass
    assert store.learner_waiting.share() > 0
    # Whoever waits is woken by the experience it waits for, long before its time is up.
    sampled = []
    waiting = threading.Thread(target=lambda: sampled.append(store.sample(4, timeout=60)))
    waiting.start()
    fill(store, make_chunk)
    waiting.join(timeout=30)
    assert sampled[0] is not None


def test_a_full_run_takes_nothing_more_and_trains_what_it_owes(store, make_chunk):
    while not store.complete:
        fill(store, make_chunk)
        if not store.complete:
            assert store.sample(4, timeout=0) is not None
    with pytest.raises(IntakeFinished):
        store.accept(make_chunk())
    while not store.exhausted(4):
        assert store.sample(4, timeout=0) is not None
    assert store.sample(4, timeout=60) is None
    assert 0 <= store.limiter.surplus < 20


def test_a_resumed_full_run_stays_full(store, make_chunk):
    store.restore(environment_steps=400)
    with pytest.raises(IntakeFinished):
        store.accept(make_chunk())


def test_waiting_is_told_as_a_share_with_its_reason(store, make_chunk):
    assert "warm-up: 0 of 60" in waiting_text(store.limiter, 1.0, 0.0)
    store.limiter.inserted(60)
    assert waiting_text(store.limiter, 0.01, 0.02) == ""
    assert waiting_text(store.limiter, 0.83, 0.1).startswith(
        "the learner waits for the actors, 83% of the time"
    )
    assert waiting_text(store.limiter, 0.1, 0.5).startswith(
        "the actors wait for the learner, 50% of the time"
    )


def test_waiting_shares_add_up_over_a_report():
    now = 0.0
    waiting = WaitingTime(clock=lambda: now)
    waiting.begin()
    now = 2.0
    waiting.begin()
    now = 3.0
    waiting.end()
    waiting.end()
    now = 4.0
    assert waiting.share() == 0.75
    waiting.begin()
    now = 6.0
    assert waiting.share() == 1.0
    now = 8.0
    assert waiting.share() == 1.0


def test_policy_lag_is_told_for_each_actor_that_is_heard(make_chunk):
    now = 0.0
    arrivals = Arrivals(clock=lambda: now)
    arrivals.published_version = 7
    arrivals.arrived(make_chunk(actor="slow"))
    arrivals.published_version = 0
    arrivals.arrived(make_chunk(actor="fast"))
    assert arrivals.metrics() == {
        "policy_lag": 7.0,
        "policy_lag/slow": 7.0,
        "transitions/slow": 5.0,
        "policy_lag/fast": 0.0,
        "transitions/fast": 5.0,
    }
    now = 61.0
    assert arrivals.metrics() == {"policy_lag": 0.0}
