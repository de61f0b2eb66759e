"""The actor's log tells once a minute how it goes."""

from __future__ import annotations

import logging

import pytest
from athrl_actor.progress import ProgressLog

START = {"decisions": 0.0, "decisions_per_second": 0.0, "chunks_acknowledged": 0.0, "chunks_waiting": 0.0}
LATER = {
    "decisions": 4_810.0,
    "decisions_per_second": 81.3,
    "chunks_acknowledged": 300.0,
    "chunks_waiting": 2.0,
    "policy_version": 57.0,
    "return_mean": 812.4,
    "collision_rate": 0.25,
}


def test_progress_is_one_line_a_minute_of_what_is_known(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    now = 0.0
    progress = ProgressLog(lambda: now)
    for now in range(0, 140):
        progress.report(START if now < 100 else LATER)
    assert caplog.messages == [
        "0 decisions (0/s), 0 chunks stored, 0 wait",
        "4810 decisions (81/s), policy 57, return 812, collisions 25%, 300 chunks stored, 2 wait",
    ]
