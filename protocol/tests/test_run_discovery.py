"""An actor finds its run and the run's settings by an address."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest
import zenoh
from athrl_protocol import (
    LatestPublisher,
    LearnerNotFound,
    RunFile,
    RunNotFound,
    fetch_run_file,
    read_run_file,
    serve_run_file,
)

PATIENCE = 30.0
RUN = "announcements"
Open = Callable[[], zenoh.Session]


def test_actor_starts_with_an_address_and_a_run_name_only(listen: Open, connect: Open) -> None:
    run_file = read_run_file(None, [f"run.name={RUN}", "learner.batch=5"])
    with serve_run_file(listen(), run_file):
        assert fetch_run_file(connect(), RUN, PATIENCE) == run_file


def test_run_that_does_not_exist_is_answered_with_those_that_do(
    listen: Open, connect: Open, address: str
) -> None:
    with serve_run_file(listen(), RunFile()), pytest.raises(RunNotFound) as caught:
        fetch_run_file(connect(), "town05", 0.2)
    assert str(caught.value) == f"no run 'town05' at {address}: name one of those it has, town03"


def test_the_only_run_needs_no_name_and_several_do(listen: Open, connect: Open) -> None:
    learner, session = listen(), connect()
    other = read_run_file(None, ["run.name=other"])
    with serve_run_file(learner, RunFile()):
        assert fetch_run_file(session, None, PATIENCE) == RunFile()
        with serve_run_file(learner, other), pytest.raises(RunNotFound, match="name one of other, town03"):
            fetch_run_file(session, None, PATIENCE)


def test_learner_that_serves_nothing_is_named_after_the_timeout(
    listen: Open, connect: Open, address: str
) -> None:
    listen()
    with pytest.raises(LearnerNotFound, match=f"no learner serves run 'town03' at {address} within 0.3 s"):
        fetch_run_file(connect(), "town03", 0.3)


def test_run_file_that_comes_late_is_waited_for(listen: Open, connect: Open) -> None:
    learner = listen()
    served: list[LatestPublisher] = []
    timer = threading.Timer(0.3, lambda: served.append(serve_run_file(learner, RunFile())))
    timer.start()
    try:
        assert fetch_run_file(connect(), "town03", PATIENCE) == RunFile()
    finally:
        timer.join()
        served[0].close()
