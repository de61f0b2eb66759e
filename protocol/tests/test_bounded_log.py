"""A flood of messages is a few lines of log, which say how many there were."""

from __future__ import annotations

import pytest
from athrl_protocol.faults.bounded_log import LINES, SECONDS, BoundedLog


class _Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> _Clock:
    return _Clock()


def test_line_that_comes_again_is_logged_once_and_then_counted(clock: _Clock) -> None:
    lines: list[str] = []
    log = BoundedLog(lines.append, clock)
    for _ in range(3):
        log("a")
    assert lines == ["a"]
    clock.now += SECONDS
    log("b")
    log("a")
    assert lines == ["a", "a (2 times more)", "b", "a"]


def test_of_many_different_lines_the_first_are_logged_and_the_others_counted(clock: _Clock) -> None:
    lines: list[str] = []
    log = BoundedLog(lines.append, clock)
    for number in range(LINES + 7):
        log(str(number))
    assert lines == [str(number) for number in range(LINES)]
    clock.now += SECONDS
    log("a")
    assert lines[LINES:] == ["7 other lines were left out", "a"]
