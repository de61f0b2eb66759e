"""A router between clients and learner changes nothing for them, and gains nothing for itself."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh
from athrl_protocol import (
    ChunkIntake,
    ChunkUploader,
    EvaluationPublisher,
    EvaluationResult,
    EvaluationSubscriber,
    Keys,
    MetricsPublisher,
    MetricsReport,
    MetricsSubscriber,
    NotAdmitted,
    Phase,
    PolicyPublisher,
    PolicySubscriber,
    PolicyUpdate,
    PresenceWatcher,
    RunFile,
    RunState,
    StatePublisher,
    StateSubscriber,
    announce_presence,
    fetch_run_file,
    new_incarnation,
    open_session,
    serve_run_file,
)
from athrl_protocol.announcements.answers import FreeNames, ask_for_name, fetch_changes, serve_changes
from athrl_protocol.messages.keys import HOST_ROLE
from athrl_protocol.transport.session import open_router

RUN = "guarded"
KEYS = Keys(RUN)
PATIENCE = 30.0
SCORES = EvaluationResult("policy", 1, 1, "town03", 1, {"return_mean": 1.0})

Client = Callable[[str], zenoh.Session]


@pytest.fixture
def behind(learner: zenoh.Session, sessions, ours: Path, port: int, unused_port: int) -> Client:
    """Connects with a role's certificate to a router in front of the learner."""
    address = f"tls/127.0.0.1:{unused_port}"
    router = open_router(
        listen=address,
        connect=f"tls/127.0.0.1:{port}",
        run=RUN,
        certificates=ours,
        largest_chunk=2**18,
    )
    sessions.enter_context(router)

    def connect(role: str) -> zenoh.Session:
        session = open_session(connect=address, timeout=PATIENCE, role=role, certificates=ours / role)
        return sessions.enter_context(session)

    return connect


@pytest.fixture
def run(learner: zenoh.Session, sessions) -> ChunkIntake:
    """What a learner serves: run file, state, policy, intake of experience."""
    run_file = RunFile()
    named = run_file.model_copy(update={"run": run_file.run.model_copy(update={"name": RUN})})
    sessions.enter_context(announce_presence(learner, RUN, "learner", "learner"))
    policies = sessions.enter_context(PolicyPublisher(learner, RUN))
    policies.publish(PolicyUpdate(7, b"artefact", False, 1.0, 1, 1, 1.0))
    sessions.enter_context(StatePublisher(learner, RUN)).publish(RunState(Phase.TRAINING, 1, 2, 3, 7))
    intake = sessions.enter_context(ChunkIntake(learner, RUN, lambda chunk: None))
    sessions.enter_context(serve_run_file(learner, named))
    return intake


def test_every_role_does_its_part_through_a_router(
    run: ChunkIntake, behind: Client, learner: zenoh.Session, sessions, eventually, make_chunk
) -> None:
    actor, evaluator, viewer = behind("actor"), behind("evaluator"), behind("viewer")
    reports: list[MetricsReport] = []
    sessions.enter_context(MetricsSubscriber(viewer, RUN, reports.append))
    assert fetch_run_file(actor, RUN, PATIENCE).run.name == RUN
    for client in (actor, evaluator):
        update = sessions.enter_context(PolicySubscriber(client, RUN)).wait(PATIENCE)
        assert update is not None
        assert update.version == 7
    for client in (actor, evaluator, viewer):
        assert sessions.enter_context(StateSubscriber(client, RUN)).wait(PATIENCE) is not None
    sessions.enter_context(announce_presence(actor, RUN, "actor", "rig"))
    for watcher in (PresenceWatcher(viewer, RUN), PresenceWatcher(learner, RUN)):
        with watcher:
            assert watcher.wait_for(lambda there: ("actor", "rig") in there, PATIENCE)
            with FreeNames(learner, RUN, "actor", watcher):
                assert ask_for_name(actor, RUN, "actor", "host", PATIENCE, threading.Event()) == "actor-1"
    sessions.enter_context(announce_presence(actor, RUN, HOST_ROLE, "host"))
    with PresenceWatcher(behind("actor"), RUN) as neighbours, serve_changes(learner, RUN, ["a change"]):
        assert neighbours.wait_for(lambda there: (HOST_ROLE, "host") in there, PATIENCE)
        assert fetch_changes(viewer, RUN) == ["a change"]
    with ChunkUploader(actor, RUN, "rig", new_incarnation(), capacity=8) as uploader:
        for _ in range(5):
            assert uploader.submit(make_chunk(), PATIENCE)
        assert uploader.flush(PATIENCE)
    assert run.statistics().chunks == 5
    results = sessions.enter_context(EvaluationPublisher(evaluator, RUN))
    results.publish(SCORES)
    assert sessions.enter_context(EvaluationSubscriber(viewer, RUN)).wait(PATIENCE) == SCORES
    metrics = sessions.enter_context(MetricsPublisher(actor, RUN, "actor", "rig"))

    def has_arrived() -> bool:
        metrics.publish({"speed": 1.0})
        return bool(reports)

    eventually(has_arrived, PATIENCE)


def test_learner_hears_what_actors_behind_a_router_report(
    run: ChunkIntake, behind: Client, learner: zenoh.Session, sessions, eventually
) -> None:
    reports: list[MetricsReport] = []
    sessions.enter_context(MetricsSubscriber(learner, RUN, reports.append, role="actor"))
    metrics = sessions.enter_context(MetricsPublisher(behind("actor"), RUN, "actor", "rig"))

    def has_arrived() -> bool:
        metrics.publish({"speed": 1.0})
        return bool(reports)

    eventually(has_arrived, PATIENCE)


# Whose certificate, what it puts where it must not.
FORBIDDEN = [
    ("actor", KEYS.policy),
    ("actor", KEYS.state),
    ("actor", KEYS.metrics("evaluator", "evaluator")),
    ("actor", KEYS.evaluation("evaluator", "policy", "town03")),
    ("evaluator", KEYS.state),
    ("evaluator", KEYS.metrics("actor", "rig")),
    ("viewer", KEYS.metrics("actor", "rig")),
    ("viewer", KEYS.policy),
]


@pytest.mark.parametrize(("role", "key"), FORBIDDEN)
def test_router_holds_its_clients_to_their_roles(
    run: ChunkIntake, behind: Client, learner: zenoh.Session, received, eventually, role: str, key: str
) -> None:
    """Also where the learner would let it pass, because another of the router's clients might do that."""
    arrived = received()
    for subscribed in (KEYS.every_metrics, KEYS.every_evaluation):
        learner.declare_subscriber(subscribed, arrived)
    neighbour, actor, session = behind("evaluator"), behind("actor"), behind(role)
    for subscribed in (KEYS.policy, KEYS.state):
        neighbour.declare_subscriber(subscribed, arrived)
    probe = KEYS.metrics("actor", "probe")

    def put() -> bool:
        session.put(key, b"forged")
        learner.put(KEYS.state, b"real", congestion_control=zenoh.CongestionControl.BLOCK)
        actor.put(probe, b"")
        return {probe, KEYS.state} <= set(arrived.keys)

    eventually(put, PATIENCE)  # both ways lead through the router by now
    before = arrived.keys.count(probe)
    eventually(lambda: put() and arrived.keys.count(probe) > before + 3, PATIENCE)
    assert b"forged" not in arrived.payloads


def test_experience_comes_from_actors_behind_a_router_only(
    run: ChunkIntake, behind: Client, make_chunk
) -> None:
    with ChunkUploader(behind("viewer"), RUN, "intruder", new_incarnation(), capacity=4) as intruder:
        assert intruder.submit(make_chunk(), PATIENCE)
        with ChunkUploader(behind("actor"), RUN, "honest", new_incarnation(), capacity=4) as honest:
            assert honest.submit(make_chunk(), PATIENCE)
            assert honest.flush(PATIENCE)
        assert intruder.statistics().acknowledged == 0
    assert run.statistics().chunks == 1


@pytest.mark.parametrize("key", [KEYS.policy, KEYS.state, KEYS.run_file, KEYS.metrics("learner", "learner")])
def test_routers_certificate_cannot_speak_for_the_learner(
    run: ChunkIntake, client: Client, learner: zenoh.Session, received, key: str
) -> None:
    arrived, asked = received(), received()
    learner.declare_subscriber(f"athrl/{RUN}/**", arrived)
    session = client("router")
    session.declare_queryable(key, asked, complete=True)
    for _ in range(3):
        session.put(key, b"forged")
    probe = KEYS.metrics("actor", "probe")
    session.put(probe, b"")  # what its clients may do, it may
    arrived.wait(probe)
    assert key not in arrived.keys
    assert fetch_run_file(client("viewer"), RUN, PATIENCE).run.name == RUN
    assert asked.keys == []


def test_router_lets_nobody_in_whom_the_learner_would_not(
    behind: Client, foreign: Path, unused_port: int
) -> None:
    with pytest.raises(NotAdmitted):
        open_session(
            connect=f"tls/127.0.0.1:{unused_port}", timeout=PATIENCE, role="actor", certificates=foreign
        )


def test_role_without_a_servers_certificate_is_no_router(
    learner: zenoh.Session, sessions, ours: Path, port: int, unused_port: int
) -> None:
    for name in ("tls.crt", "tls.key"):
        (ours / "router" / name).write_bytes((ours / "actor" / name).read_bytes())
    address = f"tls/127.0.0.1:{unused_port}"
    sessions.enter_context(
        open_router(listen=address, connect=f"tls/127.0.0.1:{port}", run=RUN, certificates=ours)
    )
    with pytest.raises(NotAdmitted):
        open_session(connect=address, timeout=PATIENCE, role="actor", certificates=ours)
