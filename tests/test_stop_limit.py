"""A service that hangs while it drains is gone some time after the first signal, at once after a second."""

import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.timeout(600)

# The command with a limit of some seconds, and with a part that never ends.
HANGING = """
import sys, time
import athrl.services
athrl.services.CHECKPOINT_SECONDS = athrl.services.DRAIN_SECONDS = float(sys.argv.pop(1))
import {module}
{module}.{name} = lambda *_: time.sleep(600)
from athrl.command import main
main()
"""
HANGS = {
    "learner": ("athrl_learner.checkpoint.checkpointer", "Checkpointer.write_now"),
    "actor": ("athrl_actor.actor", "Actor._drain"),
    "evaluator": ("athrl_evaluator.broadcast", "Broadcast.close"),
}
LIMIT = 4.0
START_SECONDS = 200.0


def start(command, service: str, limit: float, *arguments: str) -> subprocess.Popen[str]:
    """Start a service that hangs when it is asked to stop."""
    module, name = HANGS[service]
    return start_program(command, HANGING.format(module=module, name=name), limit, service, *arguments)


def start_program(command, program: str, limit: float, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", program, str(limit), *arguments],
        cwd=command.folder,
        env=command.environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def start_all(command, seen, tiny: list[str], port: int, limit: float) -> dict[str, subprocess.Popen]:
    """A learner, an actor and an evaluator at work."""
    where = ["--connect", f"tcp/127.0.0.1:{port}", "--run", "stuck"]
    settings = ["--set", "run.name=stuck", "--set", "run.environment_steps=1000000"]
    services = {"learner": start(command, "learner", limit, *tiny, *settings)}
    # Only then the others: a client gives up that finds no learner within half a minute.
    seen(where[1], "stuck", lambda run: True, START_SECONDS)
    services["actor"] = start(command, "actor", limit, *where, "--name", "one")
    services["evaluator"] = start(command, "evaluator", limit, *where)
    at_work = {("actor", "one"), ("evaluator", "evaluator")}
    seen(where[1], "stuck", lambda run: at_work <= run.present, START_SECONDS)
    return services


def test_service_that_hangs_in_its_drain_is_ended_after_its_limit(
    command, seen, tiny: list[str], port: int
) -> None:
    services = start_all(command, seen, tiny, port, LIMIT)
    for name in ("evaluator", "actor", "learner"):
        services[name].send_signal(signal.SIGTERM)
        _, said = services[name].communicate(timeout=60)
        assert services[name].returncode == 1, said
        last = said.splitlines()[-1]
        assert last.startswith(f"athrl: stopping took more than {LIMIT:g} s and is aborted, in athrl"), said
    assert not command.left()


def test_service_that_hangs_in_its_drain_is_ended_by_a_second_signal(
    command, seen, tiny: list[str], port: int
) -> None:
    services = start_all(command, seen, tiny, port, 3600.0)
    for name in ("evaluator", "actor", "learner"):
        services[name].send_signal(signal.SIGTERM)
        with pytest.raises(subprocess.TimeoutExpired):  # it does hang
            services[name].wait(timeout=2)
        services[name].send_signal(signal.SIGINT)
        assert services[name].wait(timeout=30) == 128 + signal.SIGINT
    assert not command.left()


TRAIN = """
import sys, time
import athrl.train.command, athrl.train.session
athrl.train.command.STOP_SECONDS = float(sys.argv.pop(1))
athrl.train.session.TrainingSession._drain = lambda self: time.sleep(600)
from athrl.command import main
main()
"""


def test_whole_run_that_hangs_in_its_drain_leaves_no_process(
    command, seen, eventually, tiny: list[str], port: int
) -> None:
    long = ["--set", "run.environment_steps=1000000"]
    arguments = [*tiny, *long, "--name", "stuck", "--actors", "1", "--viewer-port", "0"]
    run = start_program(command, TRAIN, LIMIT, "train", *arguments)
    there = ("evaluator", "evaluator")
    seen(f"tcp/127.0.0.1:{port}", "stuck", lambda run: there in run.present, START_SECONDS)
    run.send_signal(signal.SIGTERM)
    _, said = run.communicate(timeout=60)
    assert run.returncode == 1, said
    assert "is aborted, in athrl" in said
    eventually(lambda: not command.left(), 30)
