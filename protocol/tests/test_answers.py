"""What the learner answers: names that are free, and what was changed in the run's settings."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack

import pytest
import zenoh
from athrl_protocol import (
    LearnerNotFound,
    PresenceWatcher,
    announce_presence,
    join_run,
    read_run_file,
    serve_run_file,
)
from athrl_protocol.announcements import answers
from athrl_protocol.announcements.answers import FreeNames, ask_for_name, fetch_changes, serve_changes
from athrl_protocol.messages.keys import HOST_ROLE

PATIENCE = 30.0
RUN = "answers"
LEARNER = {("learner", "learner")}
Open = Callable[[], zenoh.Session]


@pytest.fixture
def presence(listen: Open, sessions: ExitStack) -> PresenceWatcher:
    """The services that a learner sees, which gives names; `actor-4` is bound to a certificate."""
    learner = listen()
    watcher = sessions.enter_context(PresenceWatcher(learner, RUN))
    sessions.enter_context(FreeNames(learner, RUN, "actor", watcher, ["actor-4"]))
    sessions.enter_context(announce_presence(learner, RUN, "learner", "learner"))
    sessions.enter_context(serve_run_file(learner, read_run_file(None, [f"run.name={RUN}"])))
    return watcher


def ask(session: zenoh.Session, host: str) -> str | None:
    return ask_for_name(session, RUN, "actor", host, PATIENCE, threading.Event())


def test_names_are_the_lowest_that_nobody_has(
    presence: PresenceWatcher, connect: Open, sessions: ExitStack
) -> None:
    actor = connect()
    sessions.enter_context(announce_presence(actor, RUN, "actor", "actor-2"))
    assert presence.wait_for(lambda there: ("actor", "actor-2") in there, PATIENCE)
    assert [ask(actor, host) for host in ("x", "y", "z")] == ["actor-1", "actor-3", "actor-5"]
    assert ask(actor, "y") == "actor-3"


def test_containers_that_are_made_anew_have_the_names_of_those_before(
    presence: PresenceWatcher, connect: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    actor = connect()
    monkeypatch.setattr(answers, "RESERVED_SECONDS", 0.0)
    for containers in (("1c2d", "3e4f"), ("5a6b", "7c8d")):
        with ExitStack() as stack:
            for number, container in enumerate(containers, start=1):
                name = ask(actor, container)
                assert name == f"actor-{number}"
                shown = ("actor", name)
                stack.enter_context(announce_presence(actor, RUN, "actor", name))
                assert presence.wait_for(lambda there, shown=shown: shown in there, PATIENCE)
        assert presence.wait_for(lambda there: there == LEARNER, PATIENCE)


def test_actor_without_a_name_joins_under_a_free_one_and_is_found_by_its_host(
    presence: PresenceWatcher, address: str
) -> None:
    def join(name: str | None, host: str, stack: ExitStack) -> str:
        joined = join_run(
            role="actor", connect=address, run=RUN, name=name, stop=threading.Event(), stack=stack, host=host
        )
        assert joined is not None
        return joined.name

    with ExitStack() as stack:
        assert join(None, "rig-7", stack) == "actor-1"
        assert join("own", "rig-8", stack) == "own"
        expected = {("actor", "actor-1"), ("actor", "own"), (HOST_ROLE, "rig-7"), (HOST_ROLE, "rig-8")}
        assert presence.wait_for(lambda there: there == expected | LEARNER, PATIENCE)


def test_learner_that_gives_no_names_is_told_with_what_to_do(listen: Open, connect: Open) -> None:
    listen()
    with pytest.raises(LearnerNotFound, match="choose one with --name"):
        ask_for_name(connect(), RUN, "actor", "host", 0.1, threading.Event())


def test_question_that_is_no_host_gets_no_answer(presence: PresenceWatcher, connect: Open) -> None:
    assert answers._ask(connect(), f"athrl/{RUN}/free-name/actor", b"\xff / \n") is None


def test_newest_changes_are_told_and_none_without_a_learner(listen: Open, connect: Open) -> None:
    learner, viewer = listen(), connect()
    assert fetch_changes(viewer, RUN) == []
    told = [f"learner.batch was {number} and is {number + 1}" for number in range(30)]
    with serve_changes(learner, RUN, told):
        assert fetch_changes(viewer, RUN) == told[-20:]
    with serve_changes(learner, RUN, ["network.certificates was '/a\u00a0\u202eb'", "x" * 5_000]):
        assert fetch_changes(viewer, RUN) == ["network.certificates was '/a \\u202eb'", "x" * 2_000]
