"""What Prometheus finds at the learner."""

import socket
import threading
import urllib.request
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from athrl_learner import run_learner
from athrl_protocol import (
    AddressInUse,
    EvaluationPublisher,
    EvaluationResult,
    MetricsPublisher,
    RunFile,
    open_session,
)
from prometheus_client.parser import text_string_to_metric_families


@pytest.fixture
def exposed(run_file: RunFile, port: int) -> RunFile:
    """The small run, without an end, with metrics at `port`."""
    metrics = run_file.metrics.model_copy(update={"listen": str(port)})
    run = run_file.run.model_copy(update={"environment_steps": 10_000_000})
    return run_file.model_copy(update={"metrics": metrics, "run": run})


@contextmanager
def running(run_file: RunFile) -> Iterator[None]:
    stop = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        result = pool.submit(run_learner, run_file, stop=stop)
        try:
            yield
        finally:
            stop.set()
            result.result(timeout=120)


def samples(port: int) -> dict[str, float]:
    """The newest value of each name, of whatever labels; none while nothing listens."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=30) as answer:
            text = answer.read().decode()
    except OSError:
        return {}
    found = [sample for family in text_string_to_metric_families(text) for sample in family.samples]
    assert all(sample.labels["run"] == "small" for sample in found if sample.name.startswith("athrl_"))
    return {sample.name: sample.value for sample in found}


def test_learner_shows_its_run_its_actors_and_their_scores(
    exposed: RunFile, fake_actor, port: int, wait_for: Callable[[Callable[[], bool]], None]
) -> None:
    with running(exposed):
        with fake_actor:
            wait_for(lambda: samples(port).get("athrl_learner_updates_total", 0) > 0)
            with (
                open_session(connect=exposed.network.listen, timeout=30) as session,
                MetricsPublisher(session, "small", "actor", "rig") as metrics,
                EvaluationPublisher(session, "small") as results,
            ):
                results.publish(EvaluationResult("policy", 1, 1, "town03", 1, {"return_mean": 7.0}))

                def are_shown() -> bool:
                    metrics.publish({"decisions": 10.0, "speed": 3.0})
                    wanted = ("athrl_actors_decisions_total", "athrl_actor_speed_metres_per_second")
                    values = samples(port)
                    return values.get("athrl_evaluation_return_mean") == 7 and all(
                        name in values for name in wanted
                    )

                wait_for(are_shown)
            assert samples(port)["athrl_learner_actors"] == 1
            assert samples(port)["athrl_learner_disk_free_bytes"] > 0
        wait_for(lambda: samples(port)["athrl_learner_actors"] == 0)
    assert samples(port) == {}


def test_port_in_use_leaves_nothing_behind(exposed: RunFile, port: int) -> None:
    with (
        socket.create_server(("127.0.0.1", port)),
        pytest.raises(AddressInUse, match=f"cannot serve metrics at 127.0.0.1:{port}: another process"),
    ):
        run_learner(exposed, stop=threading.Event())
    assert not list(Path(exposed.run.folder).glob("small/*.toml"))
