"""`athrl watch` draws live frames through a rerun server, or on its page, and does not accumulate them."""

import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from urllib.request import urlopen

import psutil
import pytest
import rerun_cli
from athrl_evaluator.recording.recordings import EpisodeRecording
from athrl_evaluator.watching.browser import tell
from athrl_evaluator.watching.viewer import Server, server_process
from athrl_evaluator.watching.watch import FrameQueue, viewer_of, watch, watch_recording
from athrl_protocol import (
    AddressInUse,
    Frame,
    FramePublisher,
    LearnerNotFound,
    Phase,
    Presence,
    ProtocolError,
    RunNotFound,
    announce_presence,
)


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


def test_waiting_for_an_empty_queue_ends():
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
def test_frames_reach_a_viewer_of_the_rerun_server(learner, port: int, tmp_path: Path):
    stop = threading.Event()
    arguments = {
        "connect": learner.address,
        "run": "test",
        "role": "actor",
        "name": "one",
        "server": Server(port),
    }
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
                    "auto",  # not that of a viewer that is already open
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
def test_watching_ends_when_the_viewer_is_closed(learner, port: int, monkeypatch: pytest.MonkeyPatch):
    started: list[subprocess.Popen] = []

    @contextmanager
    def remembered(server: Server) -> Iterator[subprocess.Popen]:
        with server_process(server) as process:
            started.append(process)
            yield process

    monkeypatch.setattr("athrl_evaluator.watching.watch.server_process", remembered)
    arguments = {"connect": learner.address, "run": "test", "role": "actor", "name": "one"}
    watching = threading.Thread(target=watch, kwargs=arguments | {"server": Server(port)}, daemon=True)
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


@pytest.mark.parametrize("waiting", ["open_session", "fetch_run_file"])
def test_a_stop_while_a_learner_is_waited_for_is_no_error(monkeypatch: pytest.MonkeyPatch, waiting: str):
    def stopped(*_: object, stop: threading.Event, **__: object) -> None:
        stop.set()
        raise LearnerNotFound("no learner")

    monkeypatch.setattr(f"{watch.__module__}.open_session", lambda **_: nullcontext())
    monkeypatch.setattr(f"{watch.__module__}.{waiting}", stopped)
    watch(connect="tcp/127.0.0.1:1", run=None, server=Server(1), stop=threading.Event())


def test_a_server_tells_the_address_at_which_it_is_published(port: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("ATHRL_VIEWER_ADDRESS", "10.0.0.1:80")
    with viewer_of(Server(port)) as viewer:
        assert viewer.address == "rerun+http://10.0.0.1:80/proxy"


def test_page_leads_to_the_frames_and_is_at_loopback(free_port: Callable[[], int]) -> None:
    server = Server(free_port(), page_port=free_port())
    frames = f"rerun%2Bhttp://127.0.0.1:{server.port}/proxy"
    with viewer_of(server) as viewer:
        assert viewer.address == f"http://127.0.0.1:{server.page_port}/?url={frames}"
        with urlopen(viewer.address, timeout=60) as answer:
            assert b"re_viewer.js" in answer.read()
        assert {bound(server.port), bound(server.page_port)} == {"127.0.0.1"}


def bound(port: int | None) -> str:
    """The address at which this machine listens at a port."""
    addresses = {
        each.laddr.ip
        for each in psutil.net_connections("tcp")
        if each.status == psutil.CONN_LISTEN and each.laddr.port == port
    }
    (address,) = addresses
    return address


def test_page_behind_a_proxy_is_told_as_the_proxy_shows_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ATHRL_VIEWER_ADDRESS", "https://athrl.example.org:443")
    monkeypatch.setenv("ATHRL_VIEWER_PAGE", "https://athrl.example.org/")
    address = Server(1, "0.0.0.0", 2).shown_address
    assert address == "https://athrl.example.org/?url=rerun%2Bhttps://athrl.example.org:443/proxy"


def test_page_is_not_opened_to_others_by_the_way(free_port: Callable[[], int]) -> None:
    server = Server(free_port(), "0.0.0.0", free_port())
    with pytest.raises(ProtocolError, match=r"--bind 0\.0\.0\.0: .*ATHRL_VIEWER_PAGE"), viewer_of(server):
        pass


@pytest.mark.parametrize(
    ("bind", "message"),
    [
        ("localhost", "--bind localhost: should be an IP address of this machine, such as 127.0.0.1"),
        ("", "--bind : should be an IP address"),
        ("192.0.2.1", "--bind 192.0.2.1: this machine has no such address"),
        ("2001:db8::1", "--bind 2001:db8::1: this machine has no such address"),
    ],
)
def test_what_is_no_address_of_this_machine_is_refused(
    bind: str, message: str, free_port: Callable[[], int]
) -> None:
    with pytest.raises(ProtocolError, match=f"^{message}"), viewer_of(Server(free_port(), bind)):
        pass


def test_page_at_the_loopback_of_ip_version_6(free_port: Callable[[], int]) -> None:
    server = Server(free_port(), "::1", free_port())
    with viewer_of(server) as viewer:
        assert viewer.address.startswith(f"http://[::1]:{server.page_port}/?url=rerun%2Bhttp://%5B::1%5D:")
        with urlopen(viewer.address, timeout=60) as answer:
            assert b"re_viewer.js" in answer.read()
        assert {bound(server.port), bound(server.page_port)} == {"::1"}


def test_a_taken_port_of_the_page_is_an_error_that_names_it(free_port: Callable[[], int]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with (
            pytest.raises(AddressInUse, match=f"127.0.0.1:{port}"),
            viewer_of(Server(free_port(), page_port=port)),
        ):
            pass


def test_without_a_browser_one_line_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", lambda _: False)
    tell("watching", "http://127.0.0.1:9890/")
    assert capsys.readouterr().out.splitlines()[1:] == [
        "there is no browser on this machine: open that address elsewhere, see --help"
    ]


def test_a_taken_port_is_an_error_that_names_it(learner):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(AddressInUse, match=f"127.0.0.1:{port}"):
            watch(connect=learner.address, run="test", server=Server(port))


def test_a_machine_without_a_screen_is_told_how_to_watch(learner, monkeypatch: pytest.MonkeyPatch):
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(ProtocolError, match="--serve PORT"):
        watch(connect=learner.address, run="test")


def test_a_run_that_does_not_exist_is_named(learner, port: int):
    with pytest.raises(RunNotFound, match="'other'"):
        watch(connect=learner.address, run="other", server=Server(port))


def test_a_missing_actor_is_named_with_the_present_ones(learner, actor, port: int, monkeypatch):
    monkeypatch.setattr("athrl_evaluator.watching.watch.ACTOR_SECONDS", 1.0)
    with pytest.raises(RunNotFound, match="no actor 'two'; it has one"):
        watch(connect=learner.address, run="test", role="actor", name="two", server=Server(port))


def test_a_server_of_viewers_ends_with_its_run(learner, actor, port: int):
    arguments = {"connect": learner.address, "run": None, "role": "actor", "name": "one"}
    watching = threading.Thread(target=watch, kwargs=arguments | {"server": Server(port)}, daemon=True)
    watching.start()
    learner.announce(Phase.FINISHED, 3)
    watching.join(5)
    assert watching.is_alive(), "the actor is still there"
    actor.close()
    watching.join(150)
    assert not watching.is_alive()


def test_a_recording_is_shown_as_it_was_seen_live(port: int, tmp_path: Path):
    recording = EpisodeRecording(tmp_path / "episode.mcap")
    for step in range(5):
        recording.write(frame(step))
    recording.finish()
    stop, seen = threading.Event(), tmp_path / "seen.rrd"
    arguments = {"server": Server(port), "stop": stop}
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
