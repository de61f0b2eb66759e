"""What the manifests say has run: a Docker engine starts it, with the same users, volumes and networks.

Needs root, a Docker engine and the images (`make images`). The tests share one run.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator

import pytest

from tests.compose.containers import inspect, wait
from tests.kubernetes.cluster_api import ClusterApi
from tests.kubernetes.engine import Engine, make_api_network, reaches, remove_all
from tests.kubernetes.manifests import Overlay

SERVICES = ("learner", "router", "actor", "evaluator", "viewer", "tensorboard")
RUN_SETTINGS = (
    "run.environment_steps=10000000 environment.vehicles=20 environment.episode_ticks=120"
    " exploration.random_decisions=200 planner.hidden_features=32 planner.head_features=32"
    " replay.capacity=20000 learner.batch=64 learner.samples_per_insert=4 evaluator.episodes=2"
    " evaluator.seconds_between=1 learner.threads=1 actor.environments=4"
)
"""Beside what the manifests say: a run that shows within a minute whether it learns."""

pytestmark = pytest.mark.timeout(1800)


@pytest.fixture(scope="module")
def engine(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Engine]:
    """The pods of an overlay with a router, all started."""
    if not request.config.getoption("--kubernetes"):
        pytest.skip("containers only with --kubernetes")
    overlay = Overlay("spot")
    for each in overlay.of("ConfigMap").values():
        if "ATHRL_SET" in each["data"]:
            each["data"]["ATHRL_SET"] = RUN_SETTINGS
    folder = tmp_path_factory.mktemp("kubernetes")
    for each in (folder, *folder.parents[:2]):
        each.chmod(0o755)  # for the users in the containers
    remove_all()
    host = make_api_network()
    api = ClusterApi(folder / "cluster", list(overlay.of("Secret")), host)
    api.account.chmod(0o755)
    engine = Engine(overlay, folder, api, host)
    with api.serving():
        try:
            engine.make_networks()
            engine.run_job("certificates")
            for service in SERVICES:
                engine.start(service)
            yield engine
        finally:
            engine.tell()
            remove_all()


@pytest.mark.parametrize("service", SERVICES)
def test_pod_becomes_ready_by_its_own_probe(engine: Engine, service: str) -> None:
    engine.await_ready(service)


def test_run_grows_on_what_the_actor_behind_the_router_sends(engine: Engine) -> None:
    updates = wait("the first updates", lambda: status(engine).get("updates", 0), 300)
    wait("more updates", lambda: status(engine).get("updates", 0) > updates, 120)
    assert len(status(engine)["actors"]) == 1


def test_containers_have_the_users_and_rights_of_their_pods(engine: Engine) -> None:
    for name, container in engine.started.items():
        found = inspect(container)
        assert found["Config"]["User"] == "10001:10001", name
        assert found["HostConfig"]["ReadonlyRootfs"], name
        assert found["HostConfig"]["CapDrop"] == ["ALL"], name


def test_nobody_reaches_whom_the_policies_do_not_let(engine: Engine) -> None:
    assert reaches(engine.started["actor"], "router", 7447)
    assert reaches(engine.started["router"], "learner", 7447)
    assert not reaches(engine.started["actor"], "learner", 7447)
    assert not reaches(engine.started["evaluator"], "router", 7447)
    assert not reaches(engine.started["tensorboard"], "learner", 7447)


def status(engine: Engine) -> dict:
    """What `athrl status --json` of the viewer's pod says; empty while it says nothing."""
    command = ["docker", "exec", engine.started["viewer"], "athrl", "status", "--json"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    return json.loads(result.stdout) if result.returncode == 0 else {}
