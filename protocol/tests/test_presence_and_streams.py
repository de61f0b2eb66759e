"""Presence, metrics, and frames that are only sent while there is a watcher."""

from __future__ import annotations

import contextlib
import math
import subprocess
import sys
import threading
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
import zenoh
from athrl_protocol import (
    Frame,
    FramePublisher,
    InvalidMessage,
    Keys,
    MetricsPublisher,
    MetricsReport,
    MetricsSubscriber,
    NameTaken,
    Point,
    PresenceWatcher,
    ProtocolError,
    Vehicle,
    announce_presence,
    decode_frame,
    encode_frame,
    subscribe_frames,
)
from athrl_protocol.announcements import joining
from athrl_protocol.announcements.presence import PresencePoll
from athrl_protocol.messages.frame import frame_of
from athrl_protocol.messages.keys import role_and_name_of

PATIENCE = 30.0
RUN = "presence"
Open = Callable[[], zenoh.Session]
Eventually = Callable[[Callable[[], bool]], None]

ACTOR = """
import sys, threading
from athrl_protocol import announce_presence, open_session
with open_session(connect=sys.argv[1], timeout=30) as session:
    presence = announce_presence(session, "presence", "actor", "a")
    threading.Event().wait(60)
"""


def test_services_are_seen_whenever_they_come_and_until_they_go(listen: Open, connect: Open) -> None:
    learner = listen()
    with announce_presence(connect(), RUN, "actor", "early"), PresenceWatcher(learner, RUN) as watcher:
        assert watcher.wait_for(lambda present: ("actor", "early") in present, PATIENCE)
        with announce_presence(connect(), RUN, "evaluator", "late"):
            assert watcher.wait_for(lambda present: len(present) == 2, PATIENCE)
            assert watcher.present() == {("actor", "early"), ("evaluator", "late")}
        assert watcher.wait_for(lambda present: present == {("actor", "early")}, PATIENCE)


def test_killed_service_is_gone_from_the_set(address: str, listen: Open) -> None:
    with PresenceWatcher(listen(), RUN) as watcher:
        actor = subprocess.Popen([sys.executable, "-c", ACTOR, address])
        try:
            assert watcher.wait_for(lambda present: present == {("actor", "a")}, PATIENCE)
        finally:
            actor.kill()
            actor.wait(PATIENCE)
        assert watcher.wait_for(lambda present: not present, PATIENCE)


def test_services_are_seen_again_by_a_learner_that_returned(listen: Open, connect: Open) -> None:
    learner = listen()
    watching = connect()
    with announce_presence(connect(), RUN, "actor", "a"), PresenceWatcher(watching, RUN) as other:
        assert other.wait_for(lambda present: present == {("actor", "a")}, PATIENCE)
        learner.close()
        with PresenceWatcher(listen(), RUN) as watcher:
            assert watcher.wait_for(lambda present: present == {("actor", "a")}, PATIENCE)
        assert other.wait_for(lambda present: present == {("actor", "a")}, PATIENCE)


def test_change_of_presence_is_told(listen: Open, connect: Open, eventually: Eventually) -> None:
    changes: list[frozenset[tuple[str, str]]] = []
    with PresenceWatcher(listen(), RUN, changes.append):
        with announce_presence(connect(), RUN, "actor", "a"):
            eventually(lambda: len(changes) == 1)
        eventually(lambda: len(changes) == 2)
    assert changes == [frozenset({("actor", "a")}), frozenset()]


def test_token_that_names_no_service_is_not_present(listen: Open, connect: Open) -> None:
    with PresenceWatcher(listen(), RUN) as watcher:
        stranger = connect()
        keys = [f"athrl/{RUN}/alive/{place}" for place in ("actor/a b", "actor/a\nb", "ac\x1b[2J/a")]
        tokens = [stranger.liveliness().declare_token(key) for key in keys]
        with announce_presence(stranger, RUN, "actor", "a"):  # declared last, so it is seen last
            assert watcher.wait_for(lambda present: ("actor", "a") in present, PATIENCE)
            assert watcher.present() == {("actor", "a")}
        assert len(tokens) == 3  # they lasted until here


@pytest.mark.parametrize("name", ["", "a/b", "*", "a b", "-a", "ä", "a" * 128, "a\n", "$*", "a#b"])
def test_name_that_cannot_be_a_key_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(ProtocolError, match=r"name .* cannot be used: letters, digits"):
        Keys(RUN).alive("actor", name)
    with pytest.raises(ProtocolError, match=r"run name .* cannot be used"):
        Keys(name)


def test_metrics_of_every_service_arrive(listen: Open, connect: Open, eventually: Eventually) -> None:
    reports: list[MetricsReport] = []
    learner = listen()
    with (
        MetricsSubscriber(connect(), RUN, reports.append),
        MetricsPublisher(learner, RUN, "learner", "learner") as publisher,
        MetricsPublisher(connect(), RUN, "actor", "a") as other,
    ):

        def both_arrived() -> bool:
            publisher.publish({"updates": 3, "loss": 0.25})
            other.publish({"episodes": float("inf")})
            return {report.role for report in list(reports)} == {"learner", "actor"}

        learner.put(Keys(RUN).metrics("actor", "b"), b"rubbish")
        eventually(both_arrived)
    values = {report.role: report.values for report in reports}
    assert values == {"learner": {"updates": 3.0, "loss": 0.25}, "actor": {"episodes": float("inf")}}
    assert all(report.time > 1.7e9 for report in reports)


def _frame(step: int) -> Frame:
    return Frame(
        driver="policy",
        town="town03",
        step=step,
        ego=Vehicle(x=1, y=2, heading=0.5, speed=7, length=5, width=2),
        route=[Point(x=1, y=2), Point(x=3, y=4)],
        decision={"target_speed": 4.5, "waypoint": 3.0},
        reward_terms={"speed": 1.5},
        image_height=2,
        image_width=2,
        birdeye=bytes(12),
        lidar=bytes(4),
    )


def test_frames_flow_only_while_somebody_watches(listen: Open, connect: Open, eventually: Eventually) -> None:
    listen()
    frames: list[Frame] = []
    watcher = connect()
    with FramePublisher(connect(), RUN, "actor", "a") as publisher:
        assert not publisher.watched
        for turn in range(2):
            publisher.publish(_frame(99))  # no watcher: it is not sent
            with subscribe_frames(watcher, RUN, "actor", "a", frames.append):
                eventually(lambda: publisher.watched)
                publisher.publish(_frame(turn))
                eventually(lambda turn=turn: len(frames) == turn + 1)
            eventually(lambda: not publisher.watched)
    assert [frame.step for frame in frames] == [0, 1]
    assert frames[0].route[1].y == 4
    assert dict(frames[0].decision) == {"target_speed": 4.5, "waypoint": 3.0}


def test_watcher_of_another_service_gets_nothing(listen: Open, connect: Open, eventually: Eventually) -> None:
    learner = listen()
    with (
        FramePublisher(connect(), RUN, "actor", "a") as publisher,
        FramePublisher(learner, RUN, "actor", "b") as other,
        subscribe_frames(connect(), RUN, "actor", "b", lambda _: None),
    ):
        eventually(lambda: other.watched)
        assert not publisher.watched


def test_frame_with_images_of_another_size_is_refused() -> None:
    assert decode_frame(encode_frame(_frame(3))).step == 3
    frame = _frame(3)
    frame.birdeye = bytes(11)
    with pytest.raises(InvalidMessage, match="birdeye has 11 bytes, should have 12"):
        decode_frame(encode_frame(frame))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"vehicles": [Vehicle()] * 10_001}, "10001 vehicles, should be at most 10000"),
        ({"route": [Point()] * 999}, "1001 waypoints, should be at most 1000"),
        ({"time": -1.0}, "time is -1 s, should be 0 to"),
        ({"time": 1e9}, r"time is 1e\+09 s, should be 0 to"),
        ({"time": math.nan}, "time is nan s, should be 0 to"),
    ],
)
def test_frame_that_no_town_has_is_refused(changes: dict[str, object], told: str) -> None:
    frame = _frame(3)
    frame.MergeFrom(Frame(**changes))  # type: ignore[arg-type]
    with pytest.raises(InvalidMessage, match=told):
        decode_frame(encode_frame(frame))


def test_made_up_services_are_not_kept(
    listen: Open, connect: Open, eventually: Eventually, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("athrl_protocol.announcements.presence.MOST_PRESENT", 3)
    learner, session = listen(), connect()
    with PresenceWatcher(learner, RUN) as watcher, contextlib.ExitStack() as stack:
        for number in range(10):
            stack.enter_context(announce_presence(session, RUN, "actor", f"a{number}"))
        eventually(lambda: len(watcher.present()) == 3)
        stack.close()
        eventually(lambda: not watcher.present())


def _frame_of(decision: dict[str, float], **changes: object) -> Frame:
    """The frame of a moment with this decision, as it arrives; `changes` are the scene's."""
    vehicle = SimpleNamespace(x=0.0, y=0.0, heading=0.0, speed=0.0, length=5.0, width=2.0)
    moment = {
        "time": 0.4,
        "ego": vehicle,
        "vehicles": [vehicle],
        "route": np.zeros((2, 2)),
        "waypoint": np.ones(2),
        "target_speed": 3.0,
        "steering": 0.0,
        "acceleration": 0.0,
        "reward_terms": {"speed": 1.0},
    }
    frame = frame_of(
        SimpleNamespace(**{**moment, **changes}),
        np.zeros((8, 8, 4), np.uint8),
        driver="policy",
        town="town03",
        policy_version=1,
        episode_seed=2,
        step=0,
        decision=decision,
        reward=1.0,
        episode_return=1.0,
    )
    return decode_frame(encode_frame(frame))


def test_frame_of_a_moment_holds_what_was_decided_by_name() -> None:
    for decision in ({}, {"intention": 2.0, "target_speed": 3.0, "waypoint_angle": -0.1}):
        frame = _frame_of(decision)
        assert dict(frame.decision) == decision
        assert (frame.waypoint.x, frame.waypoint.y, frame.target_speed) == (1.0, 1.0, 3.0)


def test_frame_of_a_planner_that_decides_no_waypoint_has_none() -> None:
    decision = {"acceleration": 1.5, "steering": -0.1}
    frame = _frame_of(decision, waypoint=None, target_speed=math.nan)
    assert not frame.HasField("waypoint")
    assert math.isnan(frame.target_speed)
    assert dict(frame.decision) == decision


@pytest.mark.parametrize(
    ("decision", "reason"),
    [
        ({str(number): 0.0 for number in range(257)}, "size"),
        ({"a" * 257: 0.0}, "value"),
        ({"a\nb": 0.0}, "value"),
    ],
)
def test_frame_with_a_decision_that_cannot_be_shown_is_refused(
    decision: dict[str, float], reason: str
) -> None:
    frame = _frame(3)
    frame.decision.update(decision)
    with pytest.raises(InvalidMessage) as caught:
        decode_frame(encode_frame(frame))
    assert caught.value.reason == reason


def test_who_joins_is_told_of_the_learner_and_of_namesakes_only(
    listen: Open, connect: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If each watched all others, a thousand services that join would cause a million messages."""
    told: list[tuple[str, str]] = []
    note = PresencePoll._note

    def noting(glance: PresencePoll, sample: zenoh.Sample) -> None:
        told.append(role_and_name_of(str(sample.key_expr)))
        note(glance, sample)

    learner, others = listen(), connect()
    with contextlib.ExitStack() as stack:
        stack.enter_context(announce_presence(learner, RUN, "learner", "learner"))
        all_services = stack.enter_context(PresenceWatcher(learner, RUN))
        for number in range(20):
            stack.enter_context(announce_presence(others, RUN, "actor", f"actor-{number}"))
        assert all_services.wait_for(lambda present: len(present) == 21, PATIENCE)
        monkeypatch.setattr(PresencePoll, "_note", noting)
        assert joining._take_name(connect(), RUN, "actor", "new", threading.Event(), stack)
        assert set(told) == {("learner", "learner")}
        monkeypatch.setattr(joining, "NAME_SECONDS", 0.1)
        with pytest.raises(NameTaken):
            joining._take_name(connect(), RUN, "actor", "actor-7", threading.Event(), stack)
        assert set(told) == {("learner", "learner"), ("actor", "actor-7")}
