"""A failure in a thread or in a callback is raised to callers that wait for it."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
import zenoh
from athrl_protocol import (
    BackgroundFailed,
    Chunk,
    ChunkIntake,
    ChunkUploader,
    MetricsPublisher,
    MetricsSubscriber,
    PresenceWatcher,
    announce_presence,
    new_incarnation,
)
from athrl_protocol.announcements.latest_value import LatestPublisher, LatestSubscriber
from athrl_protocol.announcements.typed import TypedSubscriber
from athrl_protocol.delivery.upload_window import UploadWindow

RUN = "background"
PATIENCE = 30.0
Open = Callable[[], zenoh.Session]


class Panic(BaseException):
    """As what PyO3 makes of a panic in Rust is no Exception either."""


def fail(*_: Any, **__: Any) -> None:
    raise Panic("no\nmemory")


def waited(call: Callable[[], object]) -> BackgroundFailed:
    """Return what a call that may wait for PATIENCE raises, which must come well before that."""
    began = time.monotonic()
    with pytest.raises(BackgroundFailed) as caught:
        call()
    assert time.monotonic() - began < PATIENCE / 2
    return caught.value


@pytest.mark.parametrize("method", ["take", "acknowledge"])
def test_uploader_whose_thread_failed_says_so_to_who_submits_or_flushes(
    listen: Open,
    connect: Open,
    make_chunk: Callable[..., Chunk],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    method: str,
) -> None:
    monkeypatch.setattr(UploadWindow, method, fail)
    learner, session = listen(), connect()
    with (
        ChunkIntake(learner, RUN, lambda chunk: None),
        ChunkUploader(session, RUN, "one", new_incarnation(), capacity=1) as uploader,
    ):
        with contextlib.suppress(BackgroundFailed):  # it may have failed already
            uploader.submit(make_chunk(), PATIENCE)
        error = waited(lambda: uploader.flush(PATIENCE))
        waited(lambda: uploader.submit(make_chunk(), PATIENCE))
    assert str(error).startswith("the upload failed: Panic: no memory (test_background.py, line ")
    assert isinstance(error.__cause__, Panic)
    assert str(error) in caplog.messages
    assert uploader.statistics().produced == sum(uploader.statistics().given_up_by_reason.values())


@pytest.mark.parametrize("broken", ["_keep", "_query", "on_value"])
def test_subscriber_whose_thread_failed_says_so_to_who_asks_for_its_value(
    listen: Open, connect: Open, monkeypatch: pytest.MonkeyPatch, eventually: Callable[..., None], broken: str
) -> None:
    if broken != "on_value":
        monkeypatch.setattr(LatestSubscriber, broken, fail)
    session = listen()
    on_value = fail if broken == "on_value" else None
    with (
        TypedSubscriber(connect(), "athrl/x/policy", bytes, on_value) as subscriber,
        LatestPublisher(session, "athrl/x/policy") as publisher,
    ):
        publisher.publish(b"value")
        eventually(lambda: subscriber._subscriber.failed)
        waited(subscriber.newest)
        waited(lambda: subscriber.wait(PATIENCE))


def test_wait_for_a_value_ends_when_decoding_it_fails(listen: Open, connect: Open) -> None:
    with (
        LatestPublisher(listen(), "athrl/x/policy") as publisher,
        TypedSubscriber(connect(), "athrl/x/policy", fail) as subscriber,
    ):
        later = threading.Timer(0.2, publisher.publish, [b"value"])
        later.start()
        error = waited(lambda: subscriber.wait(PATIENCE))
        later.join()
    assert str(error).startswith("the subscription to athrl/x/policy failed: Panic: no memory")


def test_publishers_that_never_answer_do_not_keep_the_session_waiting(listen: Open, connect: Open) -> None:
    learner = listen()
    with (
        LatestSubscriber(learner, "athrl/x/*", lambda _: None),
        PresenceWatcher(learner, RUN) as presence,
    ):
        stranger = connect()
        tokens = [stranger.liveliness().declare_token(f"athrl/x/{number}") for number in range(600)]
        with announce_presence(connect(), RUN, "actor", "a"):
            assert presence.wait_for(lambda present: ("actor", "a") in present, PATIENCE)
        assert len(tokens) == 600  # they lasted until here


def test_closed_session_is_no_failure(listen: Open, connect: Open) -> None:
    listen()
    session = connect()
    subscriber = LatestSubscriber(session, "athrl/x/policy", lambda _: None)
    session.close()
    subscriber._asker.join(PATIENCE)
    assert not subscriber._asker.is_alive()
    subscriber.check()
    subscriber.close()


def test_watch_over_presence_that_failed_says_so_to_who_waits(listen: Open, connect: Open) -> None:
    with (
        PresenceWatcher(listen(), RUN, on_change=fail) as watcher,
        announce_presence(connect(), RUN, "actor", "a"),
    ):
        waited(lambda: watcher.wait_for(lambda present: ("actor", "b") in present, PATIENCE))
        waited(watcher.present)


def test_report_that_cannot_be_taken_is_told_in_one_line_and_the_next_one_comes(
    listen: Open, connect: Open, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    came = threading.Event()

    def take(report: Any) -> None:
        if report.values["number"] == 2:
            came.set()
        else:
            fail()

    with MetricsSubscriber(listen(), RUN, take), MetricsPublisher(connect(), RUN, "actor", "a") as metrics:
        deadline = time.monotonic() + PATIENCE
        while not caplog.messages and time.monotonic() < deadline:  # until the subscription is known
            metrics.publish({"number": 1})
            time.sleep(0.02)
        metrics.publish({"number": 2})
        assert came.wait(PATIENCE)
    assert caplog.records[0].levelno == logging.ERROR
    assert caplog.messages[0].startswith("taking a report of metrics failed: Panic: no memory")
    assert "Traceback" not in "".join(capfd.readouterr())


def test_intake_whose_thread_failed_tells_the_learner(
    listen: Open,
    connect: Open,
    make_chunk: Callable[..., Chunk],
    monkeypatch: pytest.MonkeyPatch,
    eventually: Callable[..., None],
) -> None:
    monkeypatch.setattr(ChunkIntake, "_answer", fail)
    with (
        ChunkIntake(listen(), RUN, lambda chunk: None) as intake,
        ChunkUploader(connect(), RUN, "one", new_incarnation(), capacity=1) as uploader,
    ):
        uploader.submit(make_chunk(), PATIENCE)
        eventually(lambda: isinstance(intake.failure, Panic))
