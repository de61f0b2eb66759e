"""How far an uploader runs ahead of its learner."""

from __future__ import annotations

import pytest
from athrl_protocol.delivery.upload_pace import HELD_WHILE_BUSY, LONGEST_BUSY_PAUSE_SECONDS, Pace


def test_absent_learner_leaves_all_room_to_the_actor() -> None:
    pace = Pace(capacity=50)
    assert pace.max_held == 50
    pace.busy()
    pace.silent()
    assert (pace.max_held, pace.max_in_flight) == (50, 1)


def test_learner_that_takes_everything_is_sent_as_much_as_it_gives_credits_for() -> None:
    pace = Pace(capacity=50)
    pace.acknowledged(1, credits=10)
    pace.answered()
    assert (pace.max_held, pace.max_in_flight, pace.max_per_query) == (20, 10, 5)


def test_learner_that_takes_now_and_then_is_not_run_ahead_of() -> None:
    pace = Pace(capacity=500)
    for _ in range(100):  # it has room for a chunk, and then has none
        pace.busy()
        pace.acknowledged(1, credits=32)
        pace.answered()
        assert pace.max_held <= HELD_WHILE_BUSY + 1


def test_trust_comes_back_with_the_chunks_that_are_taken() -> None:
    pace = Pace(capacity=500)
    pace.busy()
    for taken in range(1, 100):
        pace.acknowledged(1, credits=32)
        pace.answered()
        assert pace.max_held == min(64, HELD_WHILE_BUSY + taken)


def test_busy_learner_is_asked_less_and_less_often_until_it_takes_something() -> None:
    pace = Pace(capacity=50)
    pauses = [pace.busy() for _ in range(10)]
    assert pauses == sorted(pauses)
    assert pauses[-1] == LONGEST_BUSY_PAUSE_SECONDS
    pace.acknowledged(1, credits=32)
    pace.answered()
    assert pace.busy() == pauses[0]


def test_capacity_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="capacity is 0"):
        Pace(capacity=0)
