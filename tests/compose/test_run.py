"""The run as containers: it grows, strangers are refused, killed services restart, `down` loses nothing.

Needs root, a Docker engine, the Compose tool and the images (`make images`). The tests share one run, in the
order in which they stand here.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.request import urlopen

import pytest
from athrl.certificates import make_all
from athrl_learner.checkpoint.content import STATE, numbered_checkpoints

from tests.chaos.audit import compare, imbalances, read_log
from tests.chaos.evidence import Evidence
from tests.compose.containers import (
    PROJECT,
    RUN,
    Containers,
    health,
    inspect,
    kill_by_host_pid,
    name_of,
    output,
    said,
    wait,
)
from tests.monitoring.prometheus import Prometheus

HERE = Path(__file__).parent
SERVICES = ("learner", "router", "actor", "actor-behind-router", "evaluator", "viewer")
ACTORS = ("actor", "actor-behind-router")
ADDRESSES = ("tls/learner:7447", "tls/router:7447")
FORGED = 1_000_000_000
NAMED_VOLUMES = {
    f"{PROJECT}_{name}"
    for name in (
        "runs",
        "kernels",
        "authority",
        "prometheus",
        *(f"{role}-certificate" for role in ("learner", "actor", "evaluator", "viewer", "router")),
    )
}

SECONDS_OF_THE_REST = 60.0
"""How long a resumed run lasts: longer than actors behind a router need to start, after two health checks."""

pytestmark = pytest.mark.timeout(900)


@pytest.fixture(scope="module")
def evidence(containers: Containers) -> Evidence:
    """What the actors wrote down."""
    return Evidence(containers.folder / "evidence")


def test_wrong_settings_are_told_once_and_start_nothing(containers: Containers) -> None:
    settings = containers.environment["ATHRL_SET"]
    containers.environment["ATHRL_SET"] = "run.environment_steps=many"
    try:
        result = containers.call("up", "--detach", "--no-build")
        assert result.returncode != 0
        check = containers.of("check")
        assert inspect(check)["State"]["ExitCode"] == 2
        assert inspect(check)["RestartCount"] == 0
        assert len(said(check).splitlines()) == 1
        assert "run.environment_steps" in said(check)
        started = [
            inspect(each)["State"]["StartedAt"]
            for name in SERVICES
            for each in containers.all(f"service={name}")
        ]
        assert [when for when in started if not when.startswith("0001")] == []
    finally:
        containers.environment["ATHRL_SET"] = settings
        containers.run("down", "--volumes", "--timeout", "10")


@pytest.fixture(scope="module")
def run(containers: Containers, evidence: Evidence) -> Iterator[Containers]:
    """A run that trains on what both actors send."""
    containers.up()
    await_both_actors(containers, evidence, since=0.0)
    wait("the first updates", lambda: containers.status().get("updates", 0) > 0, 300)
    return containers


def await_both_actors(run: Containers, evidence: Evidence, since: float) -> None:
    """Wait until chunks of the actor at the learner and of the one behind the router are acknowledged."""
    for service in ACTORS:
        name = name_of(run.of(service))
        wait(f"{service} to deliver", lambda name=name: evidence.last_acknowledgement(name) > since, 300)


def scored(run: Containers) -> int:
    """Return the version of the policy that was scored last."""
    return int(run.status().get("evaluations", {}).get("policy", {}).get("policy_version", -1))


def test_run_grows(run: Containers) -> None:
    updates = wait("the run's state", run.status, 120)["updates"]
    wait("more updates", lambda: run.status().get("updates", 0) > updates, 120)
    first = wait("a policy's first score", lambda: max(scored(run), 0), 300)
    wait("a newer policy's score", lambda: scored(run) > first, 300)


def test_each_service_has_only_its_own_key(run: Containers) -> None:
    for service in SERVICES:
        keys = ("find", "/certificates", "-name", "*.key", "-printf", "%p %m\n")
        role = "actor" if service in ACTORS else service
        found = output("docker", "exec", run.of(service), *keys)
        assert found.splitlines() == [f"/certificates/{role}/tls.key 600"]


def test_containers_may_write_and_take_only_what_they_need(run: Containers) -> None:
    for service in SERVICES:
        container = inspect(run.of(service))
        limits = container["HostConfig"]
        assert limits["ReadonlyRootfs"], service
        assert limits["CapDrop"] == ["ALL"], service
        assert limits["SecurityOpt"] == ["no-new-privileges:true"], service
        assert limits["Memory"] > 0, service
        assert limits["LogConfig"]["Config"]["max-size"] == "10m", service
        assert container["Config"]["User"] == "athrl", service


def test_viewer_tells_the_address_on_the_host(run: Containers) -> None:
    frames = f"rerun%2Bhttp://127.0.0.1:{run.environment['ATHRL_VIEWER_PORT']}/proxy"
    page = f"http://127.0.0.1:{run.environment['ATHRL_PAGE_PORT']}/?url={frames}"
    wait("the viewer's address", lambda: page in said(run.of("viewer")), 120)
    with urlopen(page, timeout=60) as answer:
        assert b"re_viewer.js" in answer.read()


def intrude(folder: Path) -> dict[str, str]:
    """Let a container that has these certificates try to get in at learner and router."""
    inside = ["--network", f"{PROJECT}_default", "--volume", f"{folder}:/certificates:ro", "--user", "0"]
    python = ["--rm", "--interactive", "--entrypoint", "python", "athrl/actor", "-"]
    docker = ["docker", "run", *inside, *python, "/certificates", *ADDRESSES]
    return json.loads(output(*docker, script=HERE / "intruder.py"))


def test_prometheus_of_the_profile_scrapes_the_run_from_inside(run: Containers) -> None:
    prometheus = Prometheus(int(run.environment["ATHRL_PROMETHEUS_PORT"]))
    run.run("--profile", "monitoring", "up", "--detach", "--no-build", "prometheus")
    try:
        wait("Prometheus", prometheus.ready, 60)
        jobs = {"athrl-learner": "up", "athrl-evaluator": "up", "athrl-router": "up"}
        wait("every service to be scraped", lambda: prometheus.targets() == jobs, 120)
        wait("both actors' figures", lambda: prometheus.values("athrl_actors_reporting") == [2.0], 120)
        wait("its health", lambda: health(run.of("prometheus")) == "healthy", 120)
        assert inspect(run.of("prometheus"))["HostConfig"]["ReadonlyRootfs"]
    finally:
        run.run("--profile", "monitoring", "rm", "--stop", "--force", "prometheus")


def test_container_with_a_certificate_of_the_run_gets_in(run: Containers) -> None:
    """So it is for want of one that others do not."""
    assert intrude(Path(run.viewer())) == dict.fromkeys(ADDRESSES, "admitted")


@pytest.mark.parametrize(
    ("shows", "refusal"),
    [("nothing", "peer sent no certificates"), ("a foreign certificate", "invalid peer certificate")],
)
def test_intruder_in_the_runs_network_gets_nowhere_and_the_log_says_so(
    run: Containers, tmp_path: Path, shows: str, refusal: str
) -> None:
    """It trusts the run's authority, which is no secret, so that it gets as far as it can."""
    if shows == "a foreign certificate":
        make_all(tmp_path, [], days=2)
    folder = tmp_path / "viewer"
    folder.mkdir(exist_ok=True)
    shutil.copy(Path(run.viewer()) / "ca.crt", folder)
    attempts = intrude(folder)
    assert "admitted" not in attempts.values()
    assert set(attempts) == set(ADDRESSES)
    for service in ("learner", "router"):
        log = run.of(service)
        line = f"a connection was refused: '{refusal}"
        wait(f"the refusal in the log of {service}", lambda log=log, line=line: line in said(log), 30)


def test_nobody_without_a_certificate_gets_in_from_the_host(run: Containers) -> None:
    for address in (f"tcp/127.0.0.1:{run.port}", f"tls/127.0.0.1:{run.port}"):
        command = [sys.executable, "-m", "athrl", "status", "--connect", address, "--run", RUN, "--json"]
        result = subprocess.run(command, capture_output=True, text=True, timeout=90)
        assert result.returncode == 2
        assert "certificate" in result.stderr


def test_actors_certificate_publishes_no_policy(run: Containers) -> None:
    """Neither at the learner nor to its neighbours behind the router."""
    actor = run.of("actor")
    before = scored(run)
    for address in ADDRESSES:
        forger = ["docker", "exec", "--interactive", actor, "python", "-", address, RUN, str(FORGED)]
        output(*forger, script=HERE / "forger.py")
    for service in ("learner", "router"):
        assert f"not allowed: Put on 'athrl/{RUN}/policy' with the certificate 'actor'" in said(
            run.of(service)
        )
    wait("the learner's next policy to be scored", lambda: scored(run) > before, 120)
    status = run.status()
    assert status["evaluations"]["policy"]["policy_version"] < FORGED
    assert set(status["actors"]) == {name_of(run.of(service)) for service in ACTORS}
    for metrics in status["actors"].values():
        assert before < metrics["policy_version"] < FORGED


@pytest.mark.parametrize("service", ["actor", "router", "learner"])
def test_run_goes_on_when_a_service_is_killed_by_its_host_pid(
    run: Containers, evidence: Evidence, service: str
) -> None:
    reached = run.status()["environment_steps"]
    back = kill_by_host_pid(run.of(service))
    await_both_actors(run, evidence, since=back)
    now = wait("the run's state", run.status, 120)
    assert now["environment_steps"] >= reached
    wait("more updates", lambda: run.status().get("updates", 0) > now["updates"], 120)


@pytest.fixture(scope="module")
def rest(run: Containers) -> int:
    """The decisions that a resumed run has to make to last so long; measured while the run trains."""
    first, at = run.status()["environment_steps"], time.monotonic()
    time.sleep(10)
    made = run.status()["environment_steps"] - first
    return int(SECONDS_OF_THE_REST * made / (time.monotonic() - at))


def test_every_service_is_healthy(run: Containers, rest: int) -> None:
    assert rest > 0
    checked = {service: run.of(service) for service in SERVICES}
    wait("health", lambda: {health(each) for each in checked.values()} == {"healthy"}, 120)


def test_down_loses_nothing_and_leaves_the_named_volumes(run: Containers, evidence: Evidence) -> None:
    mounts = [mount for each in run.all() for mount in inspect(each)["Mounts"]]
    volumes = {mount["Name"] for mount in mounts if mount["Type"] == "volume"}
    run.run("down")
    assert run.all() == []
    assert volumes_left(volumes) == NAMED_VOLUMES

    nothing_is_lost_or_twice(run.copy_run(), evidence)


def test_next_up_goes_on_and_all_end_with_the_run(run: Containers, rest: int, evidence: Evidence) -> None:
    run.run("down")
    reached = environment_steps(run.copy_run())
    # All other settings are the run's own; planners of the default size would be refused.
    run.environment["ATHRL_SET"] = f"run.environment_steps={reached + rest}"
    run.up()
    await_end(run)
    assert said(run.of("learner")).count("setting run.environment_steps was") == 1
    folder = run.copy_run()
    assert environment_steps(folder) >= reached + rest
    nothing_is_lost_or_twice(folder, evidence)
    assert {name_of(run.of(service)) for service in ACTORS} == {"actor-1", "actor-2"}


def test_finished_run_that_is_brought_up_again_ends_and_stays_as_it_is(run: Containers) -> None:
    before = (run.copy_run() / "evaluation.json").read_bytes()
    run.run("down")
    run.environment["ATHRL_SET"] = ""
    run.up()
    await_end(run)
    assert "the run is finished and compared" in said(run.of("learner"))
    assert (run.copy_run() / "evaluation.json").read_bytes() == before


def test_down_with_volumes_leaves_nothing(run: Containers) -> None:
    run.run("down", "--volumes")
    assert run.all() == []
    assert volumes_left(NAMED_VOLUMES) == set()


def await_end(run: Containers) -> None:
    """Wait until every service has ended; none of them was restarted."""
    services = [run.of(service) for service in SERVICES]
    wait("the end", lambda: all(inspect(each)["State"]["Status"] == "exited" for each in services), 300)
    assert [inspect(each)["State"]["ExitCode"] for each in services] == [0] * len(SERVICES)
    assert [inspect(each)["RestartCount"] for each in services] == [0] * len(SERVICES)


def environment_steps(folder: Path) -> int:
    """Return how far the newest checkpoint of a run is."""
    _, newest = numbered_checkpoints(folder / "checkpoints")[-1]
    return int(json.loads((newest / STATE).read_bytes())["environment_steps"])


def nothing_is_lost_or_twice(folder: Path, evidence: Evidence) -> None:
    """Hold the run's log and its counters to what the actors wrote down."""
    evidence.read()
    log = read_log(folder / "experience")
    account = compare(evidence, log)
    print(account)
    assert account.acknowledged > 100
    assert (account.lost, account.twice, account.foreign) == (0, 0, 0)
    assert [*log.problems, *imbalances(evidence, log, folder / "checkpoints", floods=[])] == []


def volumes_left(volumes: set[str]) -> set[str]:
    """Return which of these volumes, or others with the project's name, there are."""
    there = set(output("docker", "volume", "ls", "--quiet").split())
    return {name for name in there if name in volumes or name.startswith(PROJECT)}
