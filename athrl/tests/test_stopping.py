"""The first signal asks, the second one ends, and a parent that is gone counts as the first."""

import os
import signal
import subprocess
import sys

import pytest
from athrl.stopping import LIFELINE

SERVICE = """
import sys
from athrl.stopping import stop_on_signal
with stop_on_signal() as stop:
    print("ready", flush=True)
    assert stop.wait(60)
    print("draining", flush=True)
    if sys.argv[1:] == ["hang"]:
        import time
        time.sleep(600)
print("drained", flush=True)
"""


def start(*arguments: str, lifeline: bool = False) -> subprocess.Popen[str]:
    environment = {**os.environ, **({LIFELINE: "1"} if lifeline else {})}
    process = subprocess.Popen(
        [sys.executable, "-c", SERVICE, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def test_first_signal_drains() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        process = start()
        process.send_signal(number)
        assert process.communicate(timeout=60)[0] == "draining\ndrained\n"
        assert process.returncode == 0


def test_second_signal_ends_at_once() -> None:
    process = start("hang")
    assert process.stdout is not None
    process.send_signal(signal.SIGTERM)
    assert process.stdout.readline() == "draining\n"
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=30) == 128 + signal.SIGTERM
    process.communicate()


HANGING = """
import sys, threading, time
from athrl import stopping
stopping._MARGIN_SECONDS = 1
with stopping.stop_on_signal(before_exit=lambda: print("broken off", flush=True), within=1.0) as stop:
    print("ready", flush=True)
    stop.wait(60)
    if sys.argv[1] == "in the drain":
        time.sleep(600)
if sys.argv[1] == "behind the block":
    time.sleep(600)
if sys.argv[1] == "with the interpreter held":
    import ctypes
    ctypes.PyDLL(None).sleep(600)  # without giving up the interpreter's lock
if sys.argv[1] == "on the way out":
    threading.Thread(target=time.sleep, args=(600,)).start()
"""


@pytest.mark.parametrize(
    ("where", "code"),
    [
        ("in the drain", 1),
        ("behind the block", 1),
        ("on the way out", 1),
        ("with the interpreter held", -signal.SIGALRM),
    ],
)
def test_first_signal_limits_how_long_a_service_takes_to_leave(where: str, code: int) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", HANGING, where], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == code, errors
    if code == 1:
        assert output == "broken off\n"
        (line,) = errors.splitlines()
        assert line.startswith("athrl: stopping took more than 1 s")


def test_parent_that_is_gone_drains_the_service() -> None:
    process = start(lifeline=True)
    assert process.communicate(timeout=60)[0] == "draining\ndrained\n"
    assert process.returncode == 0


def test_standard_input_means_nothing_to_a_service_without_parent() -> None:
    process = start()
    assert process.stdin is not None
    process.stdin.close()
    process.stdin = None
    assert process.poll() is None
    process.terminate()
    assert process.communicate(timeout=60)[0] == "draining\ndrained\n"


def test_thread_that_never_ends_does_not_keep_a_command_from_leaving() -> None:
    program = """
import threading
from concurrent.futures import ThreadPoolExecutor
from athrl import stopping
stopping.EXIT_SECONDS = 1.0
ThreadPoolExecutor(1).submit(threading.Event().wait)
stopping.leave(2)
"""
    assert subprocess.run([sys.executable, "-c", program], timeout=60).returncode == 2


def test_stop_while_everything_is_loaded_ends_without_a_traceback() -> None:
    loading = subprocess.Popen(
        [sys.executable, "-X", "importtime", "-m", "athrl", "status"],
        stderr=subprocess.PIPE,
        text=True,
        # A shell starts what it puts in the background deaf to SIGINT.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert loading.stderr is not None
    assert any(line.split()[-1] == "typer" for line in loading.stderr)  # and the rest is still to come
    loading.send_signal(signal.SIGINT)
    told = loading.communicate(timeout=60)[1]
    said = [line for line in told.splitlines() if not line.startswith("import time:")]
    assert (said, loading.returncode) == ([], 130)
