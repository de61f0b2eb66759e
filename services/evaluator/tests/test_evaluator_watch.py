"""`athrl watch` draws live frames through a rerun server, and never piles them up."""

import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import rerun_cli
from athrl_evaluator.recordings import EpisodeRecording
from athrl_evaluator.viewer import server_process
from athrl_evaluator.watch import FrameQueue, watch, watch_recording
from athrl_protocol import (
    AddressInUse,
    Frame,
    FramePublisher,
    Phase,
    Presence,
    ProtocolError,
    RunNotFound,
    announce_presence,
)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def frame(step: int) -> Frame:
    vehicle = {"x": 10.0, "y": 20.0, "heading": 0.3, "speed": 5.0, "length": 4.9, "width": 2.1}
    return Frame(
        driver="policy",
        town="town03",
        step=step,
        time=0.4 * step,
        ego=vehicle,
        vehicles=[vehicle],
        route=[{"x": 12.0, "y": 20.0}],
        waypoint={"x": 14.0, "y": 20.0},
        decision={"intention": 1.0, "target_speed": 4.0},
        reward_terms={"speed": 4.0},
        image_height=32,
        image_width=32,
        birdeye=bytes(32 * 32 * 3),
        lidar=bytes(32 * 32),
    )


def test_a_full_queue_drops_the_oldest_frames():
    queue = FrameQueue(3)
    for step in range(10):
        queue.put(frame(step))
    taken = [queue.take(0) for _ in range(4)]
    assert [each and each.step for each in taken] == [7, 8, 9, None]


def test_an_empty_queue_is_not_waited_for_for_ever():
    queue = FrameQueue(3)
    threading.Timer(0.05, lambda: queue.put(frame(1))).start()
    taken = queue.take(30)
    assert taken is not None
    assert queue.take(0.01) is None


@pytest.fixture
def actor(learner) -> Iterator[Presence]:
    with announce_presence(learner.session, "test", "actor", "one") as presence:
        yield presence


@pytest.mark.usefixtures("actor")
def test_frames_reach_a_viewer_of_the_rerun_server(learner, tmp_path: Path):
    port, stop = free_port(), threading.Event()
    arguments = {"connect": learner.address, "run": "test", "role": "actor", "name": "one", "serve": port}
    watching = threading.Thread(target=watch, kwargs=arguments | {"stop": stop}, daemon=True)
    watching.start()
    file = tmp_path / "seen.rrd"
    try:
        with FramePublisher(learner.session, "test", "actor", "one") as publisher:
            deadline = time.monotonic() + 150
            while not publisher.watched:
                assert time.monotonic() < deadline
                time.sleep(0.01)
            viewer = subprocess.Popen(
                [
                    Path(rerun_cli.__file__).with_name("rerun"),
                    "--port",
                    "auto",  # not that of a viewer which somebody has open
                    f"rerun+http://127.0.0.1:{port}/proxy",
                    "--save",
                    file,
                ],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            try:
                step = 0
                while not file.exists() or b"car/ego/body" not in file.read_bytes():
                    assert time.monotonic() < deadline
                    assert watching.is_alive()
                    publisher.publish(frame(step := step + 1))
                    time.sleep(0.02)
            finally:
                viewer.kill()
                viewer.wait()
    finally:
        stop.set()
        watching.join(30)
    assert not watching.is_alive()


@pytest.mark.usefixtures("actor")
def test_watching_ends_when_the_viewer_is_closed(learner, monkeypatch: pytest.MonkeyPatch):
    started: list[subprocess.Popen] = []

    @contextmanager
    def remembered(bind: str, port: int) -> Iterator[subprocess.Popen]:
        with server_process(bind, port) as process:
            started.append(process)
            yield process

    monkeypatch.setattr("athrl_evaluator.watch.server_process", remembered)
    arguments = {"connect": learner.address, "run": "test", "role": "actor", "name": "one"}
    watching = threading.Thread(target=watch, kwargs=arguments | {"serve": free_port()}, daemon=True)
    watching.start()
    with FramePublisher(learner.session, "test", "actor", "one") as publisher:
        deadline = time.monotonic() + 150
        while not publisher.watched:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        started[0].kill()
        step = 0
        while watching.is_alive():
            assert time.monotonic() < deadline
            publisher.publish(frame(step := step + 1))
            watching.join(0.01)


def test_a_taken_port_is_an_error_that_names_it(learner):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(AddressInUse, match=f"127.0.0.1:{port}"):
            watch(connect=learner.address, run="test", serve=port)


def test_a_machine_without_a_screen_is_told_how_to_watch(learner, monkeypatch: pytest.MonkeyPatch):
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(ProtocolError, match="--serve PORT"):
        watch(connect=learner.address, run="test")


def test_a_run_that_does_not_exist_is_named(learner):
    with pytest.raises(RunNotFound, match="'other'"):
        watch(connect=learner.address, run="other", serve=free_port())


def test_an_actor_that_is_not_there_is_named_beside_those_that_are(learner, actor, monkeypatch):
    monkeypatch.setattr("athrl_evaluator.watch.ACTOR_SECONDS", 1.0)
    with pytest.raises(RunNotFound, match="no actor 'two'; it has one"):
        watch(connect=learner.address, run="test", role="actor", name="two", serve=free_port())


def test_a_server_of_viewers_ends_with_its_run(learner, actor):
    arguments = {"connect": learner.address, "run": None, "role": "actor", "name": "one"}
    watching = threading.Thread(target=watch, kwargs=arguments | {"serve": free_port()}, daemon=True)
    watching.start()
    learner.announce(Phase.FINISHED, 3)
    watching.join(5)
    assert watching.is_alive(), "the actor is still there"
    actor.close()
    watching.join(150)
    assert not watching.is_alive()


def test_a_recording_is_shown_as_it_was_seen_live(tmp_path: Path):
    recording = EpisodeRecording(tmp_path / "episode.mcap")
    for step in range(5):
        recording.write(frame(step))
    recording.finish()
    port, stop, seen = free_port(), threading.Event(), tmp_path / "seen.rrd"
    arguments = {"serve": port, "stop": stop}
    showing = threading.Thread(
        target=watch_recording, args=(tmp_path / "episode.mcap",), kwargs=arguments, daemon=True
    )
    showing.start()
    deadline = time.monotonic() + 150
    while not listens(port):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    program = Path(rerun_cli.__file__).with_name("rerun")
    viewer = subprocess.Popen(
        [program, "--port", "auto", f"rerun+http://127.0.0.1:{port}/proxy", "--save", seen]
    )
    try:
        while not seen.exists() or b"car/ego/body" not in seen.read_bytes():
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        viewer.kill()
        viewer.wait()
        stop.set()
        showing.join(30)
    assert not showing.is_alive()


def listens(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
    except OSError:
        return False
    return True
