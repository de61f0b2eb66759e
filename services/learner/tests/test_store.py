"""Intake and trainer meet in the store: who waits for whom, and when the run has all it needs."""

import contextlib
import threading
import time

import pytest
from athrl_learner import factories
from athrl_learner.components import make_experience
from athrl_learner.errors import Deadlock, DiskFull
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.intake.store import ExperienceStore
from athrl_learner.intake.waiting import WaitingTime, waiting_text
from athrl_learner.log.disk_space import DiskSpace
from athrl_protocol import Chunk, IntakeBusy, IntakeFinished, InvalidMessage


@pytest.fixture
def store(run_file, experience) -> ExperienceStore:
    return make_experience(run_file, factories.make_agent(run_file), Arrivals(), experience)


def fill(store: ExperienceStore, make_chunk, accept) -> None:
    """Insert until the store refuses."""
    while True:
        try:
            accept(store, make_chunk())
        except (IntakeBusy, IntakeFinished):
            return


def test_steps_are_counted_once_and_padding_never(store, make_chunk, accept):
    accept(store, make_chunk(length=5))
    accept(store, make_chunk(length=2, terminated=True))
    assert store.environment_steps == store.limiter.inserts == len(store.replay) == 7


def test_a_refused_chunk_changes_nothing(store, make_chunk, accept):
    with pytest.raises(InvalidMessage):
        accept(store, make_chunk(levels={}))
    assert store.environment_steps == store.limiter.inserts == len(store.replay) == 0


def test_actors_wait_while_training_lags(store, make_chunk, accept):
    fill(store, make_chunk, accept)
    before = store.environment_steps
    with pytest.raises(IntakeBusy, match="actors wait for the learner"):
        accept(store, make_chunk())
    assert store.environment_steps == before
    assert store.actors_waiting.share() > 0
    while store.sample(timeout=0) is not None:
        pass
    accept(store, make_chunk())
    assert store.environment_steps == before + 5


def test_a_long_chunk_gets_its_turn_though_short_ones_take_what_room_there_is(store, make_chunk, accept):
    def short(**fields: object) -> Chunk:
        return make_chunk(length=1, truncated=True, **fields)

    fill(store, short, accept)
    long = make_chunk(sequences=store.limiter.largest_insert // 5)
    for _ in range(5):
        assert store.sample(timeout=0) is not None
        with contextlib.suppress(IntakeBusy):
            accept(store, long)
            return
        fill(store, short, accept)
    pytest.fail("short chunks took all the room there was")


def test_training_waits_while_experience_lags(store, make_chunk, accept):
    assert store.sample(timeout=0) is None
    fill(store, make_chunk, accept)
    while store.sample(timeout=0) is not None:
        pass
    assert store.learner_waiting.share() > 0
    # A thread that waits is woken by the experience it waits for, long before its time is up.
    sampled = []
    waiting = threading.Thread(target=lambda: sampled.append(store.sample(timeout=60)))
    waiting.start()
    fill(store, make_chunk, accept)
    waiting.join(timeout=30)
    assert sampled[0] is not None


def test_a_full_run_takes_nothing_more_and_trains_what_it_owes(store, make_chunk, accept):
    while not store.complete:
        fill(store, make_chunk, accept)
        if not store.complete:
            assert store.sample(timeout=0) is not None
    with pytest.raises(IntakeFinished):
        accept(store, make_chunk())
    while not store.exhausted:
        assert store.sample(timeout=0) is not None
    assert store.sample(timeout=60) is None
    assert 0 <= store.limiter.surplus < 20


@pytest.mark.parametrize("length", [1, 2, 5])
def test_short_episodes_do_not_change_how_many_updates_there_are(store, make_chunk, accept, length):
    updates = 0
    while not store.exhausted:
        with contextlib.suppress(IntakeBusy, IntakeFinished):
            while True:
                accept(store, make_chunk(length=length, truncated=length < 5))
        while store.sample(timeout=0) is not None:
            updates += 1
    limiter = store.limiter
    due = (store.environment_steps - limiter.minimum_inserts) * limiter.ratio
    assert abs(updates * limiter.largest_sample - due) <= limiter.error_bound


def test_a_resumed_full_run_stays_full(store, make_chunk, accept):
    store.restore(environment_steps=400)
    with pytest.raises(IntakeFinished):
        accept(store, make_chunk())


def test_waiting_is_told_as_a_share_of_the_last_minute_with_its_reason(store):
    assert "warm-up: 0 of 60" in waiting_text(store.limiter, 1.0, 0.0)
    store.limiter.inserted(60)
    assert waiting_text(store.limiter, 0.01, 0.02) == ""
    assert waiting_text(store.limiter, 0.83, 0.1).startswith(
        "the learner waits for data, 83 % of the last minute"
    )
    assert waiting_text(store.limiter, 0.1, 0.5).startswith(
        "the actors wait for the learner, 50 % of the last minute"
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


def test_the_share_of_the_minute_forgets_what_was_before():
    now = 0.0
    waiting = WaitingTime(clock=lambda: now)
    waiting.begin()
    for now in range(1, 31):  # noqa: B007 - the clock reads it
        waiting.share()
    assert waiting.share_of_the_minute() == 1.0
    waiting.end()
    for now in range(31, 61):  # noqa: B007
        waiting.share()
    assert waiting.share_of_the_minute() == 0.5
    for now in range(61, 91):  # noqa: B007
        waiting.share()
    assert waiting.share_of_the_minute() == 0.0


def test_a_deadlock_is_an_error_and_no_way_of_life(store, make_chunk, accept):
    now = 0.0
    store.actors_waiting, store.learner_waiting = (WaitingTime(clock=lambda: now) for _ in range(2))
    fill(store, make_chunk, accept)
    store.limiter.error_bound = -1e9  # no limiter of ours is like that
    with pytest.raises(IntakeBusy):
        accept(store, make_chunk())
    assert store.sample(timeout=0) is None
    now = 59.0
    store.require_progress(60.0)
    now = 61.0
    with pytest.raises(Deadlock, match="waited for each other for 61 s"):
        store.require_progress(60.0)


def test_one_side_that_waits_for_long_is_no_deadlock(store, make_chunk, accept):
    now = 0.0
    store.actors_waiting, store.learner_waiting = (WaitingTime(clock=lambda: now) for _ in range(2))
    fill(store, make_chunk, accept)
    now = 1000.0
    store.require_progress(60.0)
    while store.sample(timeout=0) is not None:
        pass
    now = 2000.0
    store.require_progress(60.0)


def test_actors_that_leave_while_the_disk_is_full_are_no_deadlock(store, make_chunk, accept, monkeypatch):
    def full(*_: object) -> int:
        raise DiskFull("the disk is full")

    now = 0.0
    store.actors_waiting, store.learner_waiting = (WaitingTime(clock=lambda: now) for _ in range(2))
    store.disk_space = DiskSpace(clock=lambda: now)
    monkeypatch.setattr(store.log, "append", full)
    with pytest.raises(IntakeBusy, match="intake is paused"):
        accept(store, make_chunk())
    assert store.sample(timeout=0) is None
    now = 600.0
    store.require_progress(60.0)


@pytest.mark.parametrize("actors", [1, 4, 16])
def test_the_ratio_is_held_for_any_number_of_actors(run_file, make_chunk, accept, experience, actors):
    run = run_file.run.model_copy(update={"environment_steps": 4000})
    store = make_experience(
        run_file.model_copy(update={"run": run}), factories.make_agent(run_file), Arrivals(), experience
    )
    chunks = [make_chunk(actor=f"actor-{number}") for number in range(actors)]

    def drive(chunk: Chunk) -> None:
        with contextlib.suppress(IntakeFinished):
            while True:
                try:
                    accept(store, chunk)
                except IntakeBusy:
                    time.sleep(0.001)

    threads = [threading.Thread(target=drive, args=(chunk,)) for chunk in chunks]
    for thread in threads:
        thread.start()
    while not store.exhausted:
        store.sample(timeout=0.1)
        surplus = store.limiter.surplus
        assert not store.limiter.warmed_up or abs(surplus) <= store.limiter.error_bound
    for thread in threads:
        thread.join(timeout=60)
    tolerance = run_file.learner.samples_per_insert_tolerance
    assert store.limiter.realised_ratio == pytest.approx(store.limiter.ratio, rel=tolerance)


def test_policy_lag_is_told_for_each_actor_that_is_heard(make_chunk):
    now = 0.0
    arrivals = Arrivals(clock=lambda: now)
    for version in range(8):
        now = 2.0 * version
        arrivals.published(version)
    now = 15.0
    arrivals.arrived(make_chunk(actor="slow"))  # which drove with version 0; version 1 came 13 s ago
    arrivals.published(0)  # by a learner that resumed an old checkpoint
    arrivals.arrived(make_chunk(actor="fast"))
    assert arrivals.metrics() == {
        "policy_lag": 7.0,
        "policy_lag_seconds": 13.0,
        "policy_lag/slow": 7.0,
        "policy_lag_seconds/slow": 13.0,
        "transitions/slow": 5.0,
        "policy_lag/fast": 0.0,
        "policy_lag_seconds/fast": 0.0,
        "transitions/fast": 5.0,
    }
    now = 76.0
    assert arrivals.metrics() == {"policy_lag": 0.0, "policy_lag_seconds": 0.0}


def test_what_cannot_be_taken_in_now_is_neither_checked_nor_logged(store, make_chunk, accept, monkeypatch):
    fill(store, make_chunk, accept)
    monkeypatch.setattr(store, "_write_down", lambda *_: pytest.fail("it was logged"))
    with pytest.raises(IntakeBusy):
        store.accept(make_chunk(levels={}), b"")
