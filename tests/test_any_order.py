"""Services may start and stop in any order: nothing hangs and nothing is left running."""

import random
import signal
import time

import pytest

pytestmark = pytest.mark.timeout(300)

ROUNDS = 10
DRAIN_SECONDS = 100.0
"""A machine at work with other things takes half a minute for an import alone."""
BEFORE_THE_START = {-signal.SIGINT, -signal.SIGTERM, 130}
"""Exit codes of a Python that is told to stop before it has loaded the command."""


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_services_start_and_stop_in_any_order(command, tiny: list[str], port: int, seed: int) -> None:
    dice = random.Random(seed)
    where = ["--connect", f"tcp/127.0.0.1:{port}", "--run", "order"]
    services = {
        "learner": ["learner", *tiny, "--set", "run.name=order", "--set", "run.environment_steps=1000000"],
        "actor": ["actor", *where, "--name", "one"],
        "evaluator": ["evaluator", *where, "--folder", "runs"],
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
