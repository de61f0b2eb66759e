"""A dead service is restarted up to its limit, then all services are ended."""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from athrl.errors import CommandError
from athrl.train.process import ServiceProcess
from athrl.train.supervisor import Service, ServiceDied, Supervisor


def service(tmp_path: Path, script: str, **settings: object) -> Service:
    """A service that runs a Python script in place of a subcommand."""
    process = ServiceProcess("one", [], tmp_path / "logs" / "one.log")
    process.command = [sys.executable, "-c", script]
    return Service(process, **{"restarts": 0, **settings})  # type: ignore[arg-type]


def watch(supervisor: Supervisor, until: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 30
    while not until():
        assert time.monotonic() < deadline
        supervisor.check()
        time.sleep(0.02)


def test_service_that_ends_well_is_not_started_again(tmp_path: Path) -> None:
    supervisor = Supervisor(lambda line: None)
    one = service(tmp_path, "pass", restarts=3)
    supervisor.start(one)
    watch(supervisor, lambda: one.finished)
    assert one.deaths == 0


def test_service_that_leaves_before_its_learner_is_started_again_however_often(tmp_path: Path) -> None:
    said: list[str] = []
    needed = [True]
    supervisor = Supervisor(said.append)
    one = service(tmp_path, "pass", may_leave=lambda: not needed[0], early_seconds=0.02)
    supervisor.start(one)
    watch(supervisor, lambda: one.left_early == 3)
    assert said == ["one left before its learner ended; restarting it"] * 3
    needed[0] = False
    watch(supervisor, lambda: one.finished)
    assert one.deaths == 0
    assert len(said) == 3


def test_service_that_leaves_a_little_before_the_end_is_known_stays_away(tmp_path: Path) -> None:
    said: list[str] = []
    ended: list[bool] = []
    supervisor = Supervisor(said.append)
    one = service(tmp_path, "pass", may_leave=lambda: bool(ended), early_seconds=2.0)
    supervisor.start(one)
    watch(supervisor, lambda: one.restart_at is not None)
    ended.append(True)
    watch(supervisor, lambda: one.finished)
    assert said == []


def test_dead_service_is_started_again_with_its_restart_arguments(tmp_path: Path) -> None:
    said: list[str] = []
    supervisor = Supervisor(said.append)
    one = service(tmp_path, "import sys; sys.exit(0 if 'again' in sys.argv else 1)", restarts=1)
    one.restart_arguments = ["again"]
    supervisor.start(one)
    watch(supervisor, lambda: one.finished)
    assert one.deaths == 1
    assert "one ended with code 1" in said[0]


def test_single_death_is_made_good_at_once_and_repeated_ones_ever_later(tmp_path: Path) -> None:
    said: list[str] = []
    supervisor = Supervisor(said.append)
    one = service(tmp_path, "raise SystemExit(1)", restarts=3)
    supervisor.start(one)
    watch(supervisor, lambda: one.deaths == 2)
    assert one.process.exit_code is not None
    assert one.restart_at is not None  # not yet restarted
    assert [line.rpartition("restarting it ")[2] for line in said] == ["at once", "in 1 s"]
    watch(supervisor, lambda: one.deaths == 3)
    assert said[-1].endswith("in 2 s")


def test_service_that_dies_too_often_is_reported_with_its_last_words(tmp_path: Path) -> None:
    supervisor = Supervisor(lambda line: None)
    supervisor.start(service(tmp_path, "raise SystemExit('no more disk')"))
    with pytest.raises(ServiceDied, match="no more disk"):
        watch(supervisor, lambda: False)


def test_final_error_is_not_tried_again_and_told_in_its_own_words(tmp_path: Path) -> None:
    supervisor = Supervisor(lambda line: None)
    script = "import sys; print('athrl: port 7 is in use', file=sys.stderr); sys.exit(2)"
    supervisor.start(service(tmp_path, script, restarts=3, errors_are_final=True))
    with pytest.raises(ServiceDied, match=r"^port 7 is in use$"):
        watch(supervisor, lambda: False)


def test_optional_service_is_left_dead(tmp_path: Path) -> None:
    said: list[str] = []
    supervisor = Supervisor(said.append)
    one = service(tmp_path, "raise SystemExit('no viewer')", optional=True)
    supervisor.start(one)
    watch(supervisor, lambda: one.finished)
    assert "no viewer" in said[0]


def test_service_that_does_not_drain_is_ended_with_what_it_started(tmp_path: Path) -> None:
    said: list[str] = []
    supervisor = Supervisor(said.append)
    script = (
        "import signal, subprocess, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); "
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)']); "
        "print(child.pid, flush=True); time.sleep(600)"
    )
    one = service(tmp_path, script)
    supervisor.start(one)
    watch(supervisor, lambda: bool(one.process.last_lines()))
    child = int(one.process.last_lines()[0])
    supervisor.stop([one], 0.2)
    assert not one.process.running
    assert "did not drain" in said[0]
    deadline = time.monotonic() + 10
    while running(child):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_service_that_the_system_does_not_start_is_named_in_one_line(tmp_path: Path) -> None:
    one = service(tmp_path, "pass")
    one.process.command = ["/no/such/python"]
    with pytest.raises(CommandError, match=r"^cannot start one: no such file or directory$"):
        Supervisor(lambda line: None).start(one)


def test_service_that_even_a_kill_does_not_end_keeps_no_other_alive(tmp_path: Path) -> None:
    supervisor = Supervisor(lambda line: None)
    stuck, other = (service(tmp_path, "import time; time.sleep(600)") for _ in range(2))
    for each in (stuck, other):
        supervisor.start(each)
    stuck.process.wait = lambda seconds: False  # type: ignore[method-assign]
    with pytest.raises(CommandError, match="one was killed and still runs after 10 s"):
        supervisor.end()
    assert other.process.wait(10)


def running(pid: int) -> bool:
    """Whether a process runs; one that waits to be reaped does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_group_of_a_service_that_has_ended_is_not_killed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    killed: list[int] = []
    one = service(tmp_path, "pass")
    supervisor = Supervisor(lambda line: None)
    supervisor.start(one)
    watch(supervisor, lambda: one.finished)
    monkeypatch.setattr("athrl.train.process.os.killpg", lambda group, number: killed.append(group))
    supervisor.kill()
    supervisor.end()
    assert killed == []  # its number may be another process's by now
    assert one.process.exit_code == 0
