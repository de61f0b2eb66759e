"""A short real run with endpoints to scrape: learner, evaluator, a router and an actor behind it."""

from __future__ import annotations

import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

sys.path.insert(0, str(Path(__file__).parents[2]))  # tests is no installed package

RUN = "watched"
PATIENCE = 400.0
"""For an actor and an evaluator that compile side by side on a busy machine, and the first evaluation."""

LEARNER, EVALUATOR, ROUTER = "athrl-learner", "athrl-evaluator", "athrl-router"
"""The names of Prometheus' jobs."""


@dataclass(frozen=True)
class ScrapedRun:
    """A live run.

    Attributes:
        address: of its learner.
        ports: of the endpoints, by the name of the job.
        services: the processes.
    """

    address: str
    ports: dict[str, int]
    services: list[subprocess.Popen[str]] = field(default_factory=list)

    def names(self, job: str) -> set[str]:
        """Names of the samples that an endpoint shows; none while it does not listen."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.ports[job]}/metrics", timeout=30) as answer:
                text = answer.read().decode()
        except OSError:
            return set()
        return {sample.name for family in text_string_to_metric_families(text) for sample in family.samples}

    def wait_until_shown(self, job: str, *names: str) -> None:
        """Wait until an endpoint shows these metrics; the services must not end meanwhile."""
        deadline = time.monotonic() + PATIENCE
        while not {*names} <= self.names(job):
            ended = [process.log.read_text() for process in self.services if process.poll() is not None]  # type: ignore[attr-defined]
            assert not ended, ended
            assert time.monotonic() < deadline, f"{job} does not show {names}"
            time.sleep(0.5)


@pytest.fixture(scope="module")
def scraped_run(
    shared_command,
    another_tiny: Callable[[dict[str, object]], list[str]],
    free_address: Callable[[], str],
    free_port: Callable[[], int],
) -> ScrapedRun:
    """A run that does not end by itself, with each kind of figure at its endpoints."""
    run = ScrapedRun(free_address(), {job: free_port() for job in (LEARNER, EVALUATOR, ROUTER)})
    router = free_address()
    settings = another_tiny(
        {
            "run.name": RUN,
            "run.environment_steps": 1_000_000,
            "network.listen": run.address,
            "metrics.listen": run.ports[LEARNER],
        }
    )

    def start(*arguments: str) -> None:
        run.services.append(shared_command.start(*arguments))

    def listening(job: str) -> tuple[str, str]:
        return "--metrics-listen", str(run.ports[job])

    start("learner", *settings)
    run.wait_until_shown(LEARNER, "athrl_learner_updates_total")
    start("router", "--listen", router, "--connect", run.address, *listening(ROUTER))
    run.wait_until_shown(ROUTER, "athrl_router_connections")
    start("actor", "--connect", router, "--run", RUN)
    start("evaluator", "--connect", run.address, "--run", RUN, "--folder", "runs", *listening(EVALUATOR))
    run.wait_until_shown(
        LEARNER, "athrl_evaluation_return_mean", "athrl_learner_critic_loss", "athrl_actor_return_mean"
    )
    return run
