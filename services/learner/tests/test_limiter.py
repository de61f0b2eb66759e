"""The limiter holds the ratio, never stops both sides, and survives a restart."""

import copy
import json
import math

import pytest
from athrl_learner.intake.limiter import SamplesPerInsert
from hypothesis import given
from hypothesis import strategies as st

limiters = st.builds(
    SamplesPerInsert,
    ratio=st.floats(0.01, 500),
    tolerance=st.floats(0, 1),
    minimum_inserts=st.integers(1, 3000),
    largest_insert=st.integers(1, 256),
    largest_sample=st.integers(1, 5000),
)
#: Which side is asked first at each step, and how large its request is as a share of the largest.
requests = st.lists(st.tuples(st.booleans(), st.floats(0, 1)), max_size=200)


def small_limiter(**changes: float) -> SamplesPerInsert:
    settings = {
        "ratio": 4.0,
        "tolerance": 0.1,
        "minimum_inserts": 100,
        "largest_insert": 10,
        "largest_sample": 40,
    }
    return SamplesPerInsert(**{**settings, **changes})


def take_a_step(limiter: SamplesPerInsert, insert: bool, share: float) -> bool:
    """Ask for one insert or one sample; whether it was permitted (and then counted)."""
    largest = limiter.largest_insert if insert else limiter.largest_sample
    count = max(1, round(share * largest))
    if insert and limiter.permits_insert(count):
        limiter.inserted(count)
        return True
    if not insert and limiter.permits_sample(count):
        limiter.sampled(count)
        return True
    return False


@given(limiters, requests)
def test_one_side_may_always_go_on(limiter, steps):
    for insert, share in steps:
        take_a_step(limiter, insert, share)
        assert limiter.permits_insert(limiter.largest_insert) or limiter.permits_sample(
            limiter.largest_sample
        )


@given(limiters, requests, requests)
def test_a_restored_limiter_goes_on_as_if_nothing_had_happened(limiter, before, after):
    restored = copy.copy(limiter)
    for insert, share in before:
        take_a_step(limiter, insert, share)
    restored.load_state(limiter.state())
    for insert, share in after:
        assert take_a_step(limiter, insert, share) == take_a_step(restored, insert, share)
        assert limiter.surplus == restored.surplus


@given(limiters, requests)
def test_the_surplus_stays_within_the_error_bound(limiter, steps):
    for insert, share in steps:
        take_a_step(limiter, insert, share)
        if limiter.warmed_up:
            assert -limiter.error_bound <= limiter.surplus <= limiter.error_bound


@given(limiters, requests)
def test_after_closing_only_what_is_owed_is_sampled(limiter, steps):
    for insert, share in steps:
        take_a_step(limiter, insert, share)
    limiter.close()
    owed = math.floor(limiter.surplus)
    assert not limiter.permits_insert(1)
    assert limiter.permits_sample(owed) or owed <= 0 or not limiter.warmed_up
    assert not limiter.permits_sample(max(1, owed + 1))


def test_no_sample_before_the_warm_up():
    limiter = small_limiter()
    limiter.inserted(99)
    assert not limiter.permits_sample(1)
    assert "warm-up: 99 of 100" in limiter.explain()
    limiter.inserted(1)
    assert limiter.permits_sample(40)


def test_the_long_run_ratio_is_the_wanted_one():
    limiter = small_limiter(ratio=32.0, largest_sample=160)
    for _ in range(3000):
        while limiter.permits_insert(10):
            limiter.inserted(10)
        limiter.sampled(150)
    assert limiter.realised_ratio == pytest.approx(32.0, rel=0.1)


def test_the_limiter_says_who_waits_for_whom():
    limiter = small_limiter()
    while limiter.permits_insert(10):
        limiter.inserted(10)
    assert limiter.explain().startswith("the actors wait for the learner")
    while limiter.permits_sample(40):
        limiter.sampled(40)
    assert limiter.explain().startswith("the learner waits for data")
    limiter.inserted(10)
    assert limiter.explain() == ""


def in_arrears(inserts: int) -> SamplesPerInsert:
    """A limiter of a learner that has restored so many transitions, which were not trained on."""
    limiter = small_limiter(ratio=32.0, largest_sample=160)
    limiter.inserted(inserts)
    limiter.resume()
    return limiter


def test_arrears_of_a_restart_do_not_keep_actors_waiting():
    limiter = in_arrears(5000)
    owed = limiter.surplus
    inserted = 0
    for _ in range(200):  # an update each
        limiter.sampled(160)
        while limiter.permits_insert(10):
            limiter.inserted(10)
            inserted += 10
    assert inserted == pytest.approx(200 * 160 / 32 / 2, rel=0.1)  # half as fast as without arrears
    assert limiter.surplus == pytest.approx(owed - 200 * 160 / 2, rel=0.1)


def test_arrears_are_paid_off_and_do_not_come_back():
    limiter = in_arrears(5000)
    while limiter.arrears:
        limiter.sampled(160)
        while limiter.permits_insert(10):
            limiter.inserted(10)
    for _ in range(1000):
        limiter.sampled(160)
        while limiter.permits_insert(10):
            limiter.inserted(10)
        assert limiter.surplus <= limiter.error_bound


@pytest.mark.parametrize(
    "changes",
    [
        {"ratio": 4.0},  # due are 4 * (500 - 100), taken were 8 * (500 - 100)
        {"ratio": 8.0, "minimum_inserts": 400},
        {"ratio": 8.0, "minimum_inserts": 600},  # then the warm-up goes on first
    ],
)
def test_run_resumed_with_less_training_trains_on(changes):
    """It would have waited for as much experience as the run had so far, maybe to its end."""
    limiter = small_limiter(**changes)
    limiter.load_state({"inserts": 500, "samples": 3200})
    limiter.resume()
    limiter.inserted(max(0, limiter.minimum_inserts - limiter.inserts))
    assert limiter.surplus == 0
    assert limiter.permits_sample(40)
    for _ in range(10):
        limiter.inserted(10)
        limiter.sampled(round(10 * limiter.ratio))
    assert limiter.surplus == 0


def test_restart_goes_on_with_what_was_forgiven_and_a_return_to_the_settings_ends_it():
    limiter = small_limiter()
    limiter.load_state({"inserts": 500, "samples": 3200})  # by a ratio of 8; due are 1600 by 4
    limiter.resume()
    assert limiter.forgiven == 1600
    limiter.inserted(100)
    limiter.sampled(360)  # 40 of 400 are still owed
    restored, as_before = small_limiter(), small_limiter(ratio=8.0)
    for each in (restored, as_before):
        each.load_state(json.loads(json.dumps(limiter.state())))
        each.resume()
    assert restored.surplus == limiter.surplus == 40
    assert (as_before.forgiven, as_before.surplus) == (0, 8 * (600 - 100) - 3560)


@pytest.mark.parametrize("inserts", [0, 30, 99, 100, 140])
def test_restart_with_the_same_settings_forgives_nothing(inserts):
    limiter = small_limiter()
    limiter.inserted(inserts)
    while limiter.permits_sample(40):
        limiter.sampled(40)
    surplus = limiter.surplus
    limiter.resume()
    assert limiter.forgiven == 0
    assert limiter.surplus == surplus


@given(limiters, st.integers(0, 50_000), requests)
def test_one_side_may_always_go_on_in_arrears_too(limiter, inserts, steps):
    limiter.inserted(inserts)
    limiter.resume()
    for insert, share in steps:
        take_a_step(limiter, insert, share)
        assert limiter.permits_insert(limiter.largest_insert) or limiter.permits_sample(
            limiter.largest_sample
        )
        assert limiter.surplus <= limiter.error_bound + limiter.arrears + 1e-6 * abs(limiter.surplus)


@pytest.mark.parametrize(
    "state",
    [
        {},
        {"inserts": 3},
        {"inserts": -1, "samples": 0},
        {"inserts": 1.5, "samples": 0},
        {"inserts": 1, "samples": 0, "forgiven": -1.0},
        {"inserts": 1, "samples": 0, "forgiven": "all"},
    ],
)
def test_a_wrong_state_is_refused(state):
    with pytest.raises(ValueError, match=r"(integer|number) >= 0"):
        small_limiter().load_state(state)
