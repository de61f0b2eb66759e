"""What others report under made-up names does not fill the disk."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from athrl_evaluator import report_limits
from athrl_evaluator.event_files import EventFiles
from athrl_evaluator.report_limits import MOST_AT_ONCE, MOST_VALUES, REPORTS_A_SECOND, ReportLimits
from athrl_protocol import MetricsReport


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def limits(clock: Clock) -> ReportLimits:
    return ReportLimits(clock)


def report(name: str = "actor-1", role: str = "actor", **values: float) -> MetricsReport:
    return MetricsReport(role=role, name=name, time=1.0, values=values or {"speed": 5.0})


def test_a_service_is_heard_once_a_second_and_not_much_more_often(limits: ReportLimits, clock: Clock) -> None:
    written = 0
    for _ in range(10_000):
        written += bool(limits.admitted(report()))
        clock.now += 0.01
    assert written == pytest.approx(MOST_AT_ONCE + 100 * REPORTS_A_SECOND, abs=2)
    for _ in range(10):
        clock.now += 1.0
        assert limits.admitted(report())


def test_reports_that_waited_for_the_runs_state_are_all_written(limits: ReportLimits) -> None:
    assert all(limits.admitted(report()) for _ in range(MOST_AT_ONCE))
    assert not limits.admitted(report())


def test_an_actor_reports_what_the_table_of_metrics_has(limits: ReportLimits) -> None:
    values = {"speed": 5.0, "return_mean/town03": 1.0, "made up": 2.0}
    assert limits.admitted(report(**values)) == {"speed": 5.0, "return_mean/town03": 1.0}
    many = {f"return_mean/town{number}": 1.0 for number in range(2000)}
    assert len(limits.admitted(report("actor-2", **many))) == MOST_VALUES


def test_the_learners_own_metrics_are_all_written(limits: ReportLimits) -> None:
    values = {"loss/of/a/planner/of/your/own": 1.0}
    assert limits.admitted(report("learner", "learner", **values)) == values


def test_names_are_bounded_and_make_room_for_others(
    limits: ReportLimits, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_limits, "MOST_SERVICES", 10)
    assert sum(bool(limits.admitted(report(f"actor-{number}"))) for number in range(100)) == 10
    clock.now += 1.0
    assert limits.admitted(report("actor-0"))
    clock.now += 61.0
    assert limits.admitted(report("actor-99"))


def test_curves_leave_the_reserve_of_the_disk_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    files = EventFiles(tmp_path / "tensorboard", told.append, reserve_bytes=1000)
    files.add("actor/actor-1", {"speed": 5.0}, 10, 1.0)
    (file,) = (tmp_path / "tensorboard").iterdir()
    size = file.stat().st_size
    room = os.statvfs(tmp_path)
    full = os.statvfs_result((*room[:3], 0, 0, *room[5:]))
    monkeypatch.setattr(os, "statvfs", lambda _: full)
    files.add("actor/actor-1", {"speed": 5.0}, 20, 2.0)
    assert file.stat().st_size == size
    assert "less than the reserve" in told[0]
    monkeypatch.undo()
    files.add("actor/actor-1", {"speed": 5.0}, 30, 3.0)
    assert file.stat().st_size > size
