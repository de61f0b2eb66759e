"""The learner's log tells how the run goes, once a minute, and how it ended."""

from __future__ import annotations

import logging
from dataclasses import replace

import pytest
from athrl_learner.log.disk_space import DiskSpace
from athrl_learner.reporting.progress import MOST_DRIVERS, ProgressLog, with_silent_actors
from athrl_protocol import EvaluationResult, Phase, RunState
from athrl_protocol.announcements.recent_rate import RecentRate
from athrl_protocol.faults.bounded_log import RareLog

STATE = RunState(Phase.TRAINING, 1_500, 6_000, 320, 7, "the learner waits for data")
METRICS = {"actors": 2.0, "environment_steps_per_second": 41.4, "updates_per_second": 2.55}
SCORES = {
    "episodes": 40.0,
    "return_mean": 812.4,
    "return_ci95": 90.5,
    "speed_mps": 5.1,
    "collision_rate": 0.025,
}
RESULT = EvaluationResult("policy", 6, 1_400, "town03", 1, SCORES)
REFERENCE = EvaluationResult("blind", 0, 1_400, "town03", 1, {"return_mean": 3.0, "return_ci95": 1.0})


class Clock:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def progress(clock: Clock, caplog: pytest.LogCaptureFixture) -> ProgressLog:
    caplog.set_level(logging.INFO)
    return ProgressLog(clock)


def test_thousands_of_drivers_are_not_kept(progress: ProgressLog, caplog: pytest.LogCaptureFixture) -> None:
    progress.add(RESULT)
    for number in range(10 * MOST_DRIVERS):
        progress.add(replace(REFERENCE, driver=f"made up {number}"))
    progress.add(replace(RESULT, scores={**SCORES, "return_mean": 900.0}))
    progress.tell_closing()
    assert len(caplog.messages) == MOST_DRIVERS
    assert "return 900 " in caplog.messages[0]


def test_progress_is_one_line_a_minute(
    progress: ProgressLog, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    for clock.now in range(0, 182, 1):
        progress.report(STATE, METRICS)
    assert caplog.messages[0] == (
        "training: 1500 of 6000 environment steps (41/s), 320 updates (2.5/s), policy 7, 2 actors; "
        "the learner waits for data"
    )
    assert len(caplog.messages) == 4  # when the first actor came, and after each minute


def test_progress_without_actors_says_so(
    progress: ProgressLog, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    clock.now = 59.0
    progress.report(replace(STATE, waiting=""), {**METRICS, "actors": 0.0})
    assert not caplog.messages
    clock.now = 60.0
    progress.report(replace(STATE, waiting=""), {**METRICS, "actors": 0.0})
    assert caplog.messages[0].endswith("policy 7, no actors")


def test_progress_has_the_return_of_the_policy_scored_last(
    progress: ProgressLog, caplog: pytest.LogCaptureFixture
) -> None:
    progress.add(RESULT)
    progress.add(REFERENCE)
    progress.report(STATE, METRICS)
    assert ", 2 actors, return 812 ± 90 by policy 6; " in caplog.text


def test_results_after_the_end_are_told_a_line_for_each_driver(
    progress: ProgressLog, caplog: pytest.LogCaptureFixture
) -> None:
    progress.add(replace(RESULT, driver="random"))  # of an earlier comparison
    progress.begin_closing()
    progress.add(RESULT)
    progress.add(REFERENCE)
    progress.tell_closing()
    assert caplog.messages == [
        "policy 6 in town03: 40 episodes, return 812 ± 90, 5.10 m/s, collisions 2%",
        "blind in town03: return 3 ± 1",
    ]


def test_results_in_several_towns_are_told_for_each(
    progress: ProgressLog, caplog: pytest.LogCaptureFixture
) -> None:
    towns = {f"{town}/{name}": value for town in ("town02", "town04") for name, value in SCORES.items()}
    progress.begin_closing()
    progress.add(replace(RESULT, town="2 towns", scores={**SCORES, **towns}))
    progress.tell_closing()
    assert [message.partition(":")[0] for message in caplog.messages] == [
        "policy 6 in 2 towns",
        "policy 6 in town02",
        "policy 6 in town04",
    ]


def test_end_without_a_comparison_is_told(progress: ProgressLog, caplog: pytest.LogCaptureFixture) -> None:
    progress.add(RESULT)
    progress.begin_closing()
    progress.tell_closing()
    assert caplog.messages == ["the run ends without a closing comparison: no evaluator made one"]


def test_actors_that_have_sent_nothing_yet_may_be_compiling() -> None:
    start = RunState(Phase.WARMING_UP, 0, 6_000, 0, 0, "the learner waits for the warm-up")
    assert with_silent_actors(start, 0) == start
    assert "warm-up; 1 actor has joined and sent nothing yet" in with_silent_actors(start, 1).waiting
    assert "about a minute" in with_silent_actors(start, 3).waiting
    begun = replace(start, environment_steps=1)
    assert with_silent_actors(begun, 3) == begun
    stopped = replace(start, phase=Phase.DRAINING)
    assert with_silent_actors(stopped, 3) == stopped


def test_full_disk_is_one_line_a_minute_whoever_notices_it(clock: Clock) -> None:
    lines: list[tuple[float, str]] = []
    warn = RareLog(lambda text: lines.append((clock.now, text)), clock=clock)
    disk_space = DiskSpace(warn, clock)
    cannot, pauses = "cannot write latest.onnx: disk full", "intake pauses, nothing is lost: disk full"
    for clock.now in range(0, 150):
        warn(cannot)
        disk_space.report_full("disk full")
    assert lines == [
        (0, cannot),
        (60, f"{cannot} (before that: {pauses})"),
        (120, f"{cannot} (before that: {pauses})"),
    ]


def test_pause_that_was_left_out_is_told_later_and_its_end_only_then(
    clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    lines: list[str] = []
    warn = RareLog(lines.append, clock=clock)
    disk_space = DiskSpace(warn, clock)
    warn("cannot write latest.onnx: no space left on device")
    disk_space.report_full("the disk is full")
    disk_space.report_free()
    assert "intake continues" not in caplog.text
    disk_space.report_full("the disk is full")
    clock.now = 61.0
    disk_space.report_full("the disk is full")
    assert lines[1:] == ["intake pauses, nothing is lost: the disk is full"]
    disk_space.report_free()
    assert "intake continues after 61 s" in caplog.text


def test_rate_is_that_of_the_last_minute(clock: Clock) -> None:
    rate = RecentRate(clock)
    assert rate.per_second() is None
    for clock.now in range(0, 200):
        rate.note(10.0 * clock.now if clock.now <= 120 else 1200.0)
        if clock.now == 120:
            assert rate.per_second() == pytest.approx(10.0)
        if clock.now == 150:
            assert rate.per_second() == pytest.approx(5.0)
    assert rate.per_second() == 0.0
    rate.restart()
    rate.note(0.0)
    assert rate.per_second() is None
