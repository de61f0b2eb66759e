"""An actor that leaves while its learner runs is named and counted, once."""

from __future__ import annotations

import logging

import pytest
from athrl_learner.reporting.departures import ABSENT_SECONDS, Departures


def test_actor_that_stays_away_is_named_and_counted_once(caplog: pytest.LogCaptureFixture) -> None:
    now = 0.0
    departures = Departures(clock=lambda: now)
    departures.update(frozenset({"rig-1", "rig-2"}))
    for _ in range(5):
        departures.update(frozenset({"rig-2"}))
        now += ABSENT_SECONDS / 2
    assert departures.count == 1
    warnings = [record for record in caplog.records if record.levelno == logging.WARNING]
    assert [record.getMessage() for record in warnings] == [
        "actor rig-1 left before the end of the run; 1 are present"
    ]
    departures.update(frozenset({"rig-1", "rig-2"}))
    departures.update(frozenset({"rig-2"}))
    now += ABSENT_SECONDS
    departures.update(frozenset({"rig-2"}))
    assert departures.count == 2


def test_connection_that_is_lost_for_a_moment_is_no_departure(caplog: pytest.LogCaptureFixture) -> None:
    now = 0.0
    departures = Departures(clock=lambda: now)
    for present in ({"rig"}, set(), {"rig"}, set(), {"rig"}):
        departures.update(frozenset(present))
        now += ABSENT_SECONDS / 2
    now += ABSENT_SECONDS
    departures.update(frozenset({"rig"}))
    assert departures.count == 0
    assert not caplog.records
