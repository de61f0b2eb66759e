"""Services may start and stop in any order: nothing hangs and nothing is left running."""

import random
import signal
import time
from collections.abc import Callable

import pytest

pytestmark = pytest.mark.timeout(600)

ROUNDS = 10
EVERYDAY = (0, 7)
"""Rounds of `make test`: begun with the router and with a client; most other tests begin with a learner."""
START_SECONDS = 200.0
DRAIN_SECONDS = 100.0
"""A machine at work with other things takes half a minute for an import alone."""
STOPPED = {0, 128 + signal.SIGTERM, -signal.SIGTERM}
"""Exit codes of a service that got two signals: drained before the second, ended by it, or about to leave."""
BEFORE_THE_START = {-signal.SIGINT, -signal.SIGTERM, 130}
"""Exit codes of a Python that is stopped before it has loaded the command."""


@pytest.mark.parametrize(
    "seed",
    [seed if seed in EVERYDAY else pytest.param(seed, marks=pytest.mark.slow) for seed in range(ROUNDS)],
)
def test_services_start_and_stop_in_any_order(
    command, tiny: list[str], port: int, free_address: Callable[[], str], seed: int
) -> None:
    dice = random.Random(seed)
    learner = f"tcp/127.0.0.1:{port}"
    router = free_address()
    where = ["--connect", dice.choice([learner, router]), "--run", "order"]
    services = {
        "learner": ["learner", *tiny, "--set", "run.name=order", "--set", "run.environment_steps=1000000"],
        "actor": ["actor", *where, "--name", "one"],
        "evaluator": ["evaluator", *where, "--folder", "runs"],
        "router": ["router", "--listen", router, "--connect", learner, "--run", "order"],
    }
    processes = {}
    for name in dice.sample(sorted(services), len(services)):
        processes[name] = command.start(*services[name])
        time.sleep(dice.uniform(0.0, 1.5))
    # Stopped while they start, wait for each other, or work: all of it has to come out well.
    time.sleep(dice.uniform(0.0, 8.0))
    for name in dice.sample(sorted(services), len(services)):
        processes[name].send_signal(dice.choice([signal.SIGINT, signal.SIGTERM]))
        time.sleep(dice.uniform(0.0, 1.5))
    codes = {name: process.wait(timeout=DRAIN_SECONDS) for name, process in processes.items()}
    assert set(codes.values()) <= {0, *BEFORE_THE_START}, "\n".join(
        command.said(process) for process in processes.values()
    )
    assert not command.left()


def test_second_signal_stops_each_service_at_once(
    command, seen, tiny: list[str], port: int, free_address: Callable[[], str]
) -> None:
    """Also where the first one is still at work: a paused learner keeps all others from handing over."""
    learner = f"tcp/127.0.0.1:{port}"
    router = free_address()
    name = ["--set", "run.name=order", "--set", "run.environment_steps=1000000"]
    # One after the other: a client gives up that finds none within half a minute, on a busy machine too.
    processes = [command.start("learner", *tiny, *name)]
    command.wait_until_said(processes[0], "listens at", START_SECONDS)
    processes.append(command.start("router", "--listen", router, "--connect", learner, "--run", "order"))
    seen(router, "order", lambda run: True, START_SECONDS)
    processes += [
        command.start("actor", "--connect", router, "--run", "order", "--name", "one"),
        command.start("evaluator", "--connect", router, "--run", "order", "--folder", "runs"),
    ]
    at_work = {("actor", "one"), ("evaluator", "evaluator")}
    seen(learner, "order", lambda run: at_work <= run.present, START_SECONDS)
    processes[0].send_signal(signal.SIGSTOP)
    for number in range(2):
        for process in processes[1:]:
            process.send_signal(signal.SIGTERM)
        time.sleep(0.1 + number)
    for process in processes[1:]:
        assert process.wait(timeout=DRAIN_SECONDS) in STOPPED, command.said(process)
    processes[0].send_signal(signal.SIGCONT)
    for _ in range(2):
        processes[0].send_signal(signal.SIGTERM)
        time.sleep(0.05)
    assert processes[0].wait(timeout=DRAIN_SECONDS) in STOPPED
    assert not command.left()
