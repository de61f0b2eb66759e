"""With a certificate each role does its part and nothing else, and who does its part is not disturbed."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

import pytest
import zenoh
from athrl_protocol import (
    Chunk,
    ChunkIntake,
    ChunkUploader,
    EvaluationPublisher,
    EvaluationResult,
    EvaluationSubscriber,
    Frame,
    FramePublisher,
    Keys,
    MetricsPublisher,
    MetricsReport,
    MetricsSubscriber,
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
    join_run,
    new_incarnation,
    serve_run_file,
    subscribe_frames,
)
from athrl_protocol.messages.keys import PROBE_RUN_FILE

RUN = "guarded"
KEYS = Keys(RUN)
PATIENCE = 30.0
SCORES = EvaluationResult("policy", 1, 1, "town03", 1, {"return_mean": 1.0})

Client = Callable[[str], zenoh.Session]


@pytest.fixture
def run(learner: zenoh.Session, sessions: contextlib.ExitStack) -> ChunkIntake:
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


@pytest.fixture
def everything(learner: zenoh.Session, received) -> object:
    """What arrives in the learner under the keys of the run."""
    arrived = received()
    learner.declare_subscriber(f"athrl/{RUN}/**", arrived)
    return arrived


def deliver(session: zenoh.Session, name: str, make_chunk: Callable[[], Chunk]) -> None:
    """Upload chunks as an actor does; each has to be acknowledged."""
    with ChunkUploader(session, RUN, name, new_incarnation(), capacity=8) as uploader:
        for _ in range(5):
            assert uploader.submit(make_chunk(), PATIENCE)
        assert uploader.flush(PATIENCE)
        assert uploader.statistics().acknowledged == 5


def test_actor_does_its_part(
    run: ChunkIntake, client: Client, port: int, ours, sessions, make_chunk, eventually, monkeypatch
) -> None:
    monkeypatch.setenv("ATHRL_CERTIFICATES", str(ours))
    reports: list[MetricsReport] = []
    frames: list[Frame] = []
    viewer = client("viewer")
    sessions.enter_context(MetricsSubscriber(viewer, RUN, reports.append))
    sessions.enter_context(subscribe_frames(viewer, RUN, "actor", "rig", frames.append))
    with PresenceWatcher(viewer, RUN) as presence, contextlib.ExitStack() as stack:
        joined = join_run(
            role="actor",
            connect=f"127.0.0.1:{port}",
            run=RUN,
            name="rig",
            stop=threading.Event(),
            stack=stack,
        )
        assert joined is not None
        session, run_file, _ = joined
        assert run_file.run.name == RUN
        assert presence.wait_for(lambda there: ("actor", "rig") in there, PATIENCE)
        update = stack.enter_context(PolicySubscriber(session, RUN)).wait(PATIENCE)
        assert update is not None
        assert update.version == 7
        assert stack.enter_context(StateSubscriber(session, RUN)).wait(PATIENCE) is not None
        deliver(session, "rig", make_chunk)
        assert run.statistics().chunks == 5
        metrics = stack.enter_context(MetricsPublisher(session, RUN, "actor", "rig"))
        publisher = stack.enter_context(FramePublisher(session, RUN, "actor", "rig"))
        eventually(lambda: publisher.watched, PATIENCE)
        publisher.publish(Frame(driver="policy"))
        metrics.publish({"speed": 1.0})
        eventually(lambda: frames and reports, PATIENCE)


def test_learner_hears_what_its_actors_report(
    run: ChunkIntake, client: Client, learner: zenoh.Session, sessions, eventually
) -> None:
    reports: list[MetricsReport] = []
    sessions.enter_context(MetricsSubscriber(learner, RUN, reports.append, role="actor"))
    metrics = sessions.enter_context(MetricsPublisher(client("actor"), RUN, "actor", "rig"))

    def has_arrived() -> bool:
        metrics.publish({"speed": 1.0})
        return bool(reports)

    eventually(has_arrived, PATIENCE)


def test_evaluator_and_viewer_do_theirs(run: ChunkIntake, client: Client, sessions) -> None:
    evaluator, viewer = client("evaluator"), client("viewer")
    assert fetch_run_file(viewer, None, PATIENCE).run.name == RUN
    assert sessions.enter_context(StateSubscriber(viewer, RUN)).wait(PATIENCE) is not None
    update = sessions.enter_context(PolicySubscriber(evaluator, RUN)).wait(PATIENCE)
    assert update is not None
    results = sessions.enter_context(EvaluationPublisher(evaluator, RUN))
    early = sessions.enter_context(EvaluationSubscriber(viewer, RUN))
    results.publish(SCORES)
    assert early.wait(PATIENCE) == SCORES
    late = sessions.enter_context(EvaluationSubscriber(client("viewer"), RUN))
    assert late.wait(PATIENCE) == SCORES


# Whose certificate, what it puts where it must not.
FORBIDDEN_PUTS = [
    ("actor", KEYS.policy),
    ("actor", KEYS.state),
    ("actor", KEYS.run_file),
    ("actor", KEYS.evaluation("evaluator", "policy", "town03")),
    ("actor", KEYS.metrics("learner", "learner")),
    ("actor", KEYS.live("evaluator", "evaluator")),
    ("actor", f"athrl/{RUN}/anything"),
    ("evaluator", KEYS.policy),
    ("evaluator", KEYS.state),
    ("evaluator", KEYS.metrics("actor", "rig")),
    ("viewer", KEYS.policy),
    ("viewer", KEYS.metrics("viewer", "viewer")),
    ("viewer", KEYS.evaluation("evaluator", "policy", "town03")),
]
# Role of the certificate, key of a forbidden subscription.
FORBIDDEN_SUBSCRIPTIONS = [
    ("actor", KEYS.every_experience),
    ("actor", KEYS.every_metrics),
    ("actor", KEYS.every_evaluation),
    ("actor", KEYS.every_live),
    ("actor", f"athrl/{RUN}/**"),
    ("evaluator", KEYS.every_live),
    ("viewer", KEYS.policy),
    ("viewer", "**"),
]


@pytest.mark.parametrize(("role", "key"), FORBIDDEN_PUTS)
def test_what_a_role_may_not_write_reaches_nobody(
    run: ChunkIntake, client: Client, everything, role: str, key: str
) -> None:
    session = client(role)
    declared = session.declare_publisher(key)
    for _ in range(3):
        session.put(key, b"forged")
        declared.put(b"forged")
        session.delete(key)
    # What is allowed and sent afterwards has arrived: the rest would have been there before it.
    probe = KEYS.metrics("actor", "probe")
    actor = client("actor")
    actor.put(probe, b"")
    everything.wait(probe)
    if role != "viewer":
        own = KEYS.metrics(role, "own")
        session.put(own, b"")
        everything.wait(own)
    assert key not in everything.keys


@pytest.mark.parametrize(("role", "key"), FORBIDDEN_SUBSCRIPTIONS)
def test_what_a_role_may_not_read_does_not_come(
    run: ChunkIntake, learner: zenoh.Session, client: Client, received, eventually, role: str, key: str
) -> None:
    received_keys = received()
    session = client(role)
    session.declare_subscriber(key, received_keys)
    session.declare_subscriber(KEYS.state, received_keys)

    def write_everything() -> bool:
        for written in (
            KEYS.policy,
            KEYS.experience("rig"),
            KEYS.metrics("actor", "rig"),
            KEYS.evaluation("evaluator", "policy", "town03"),
            KEYS.live("actor", "rig"),
            KEYS.state,
        ):
            learner.put(written, b"secret", congestion_control=zenoh.CongestionControl.BLOCK)
        return KEYS.state in received_keys.keys

    eventually(write_everything, PATIENCE)  # its subscription to what it may read has come
    eventually(write_everything, PATIENCE)
    assert set(received_keys.keys) == {KEYS.state}


def test_actor_cannot_take_others_experience(run: ChunkIntake, client: Client, received, make_chunk) -> None:
    thief, asked = client("actor"), received()
    thief.declare_queryable(KEYS.every_experience, asked, complete=True)
    thief.declare_queryable(f"athrl/{RUN}/**", asked, complete=True)
    deliver(client("actor"), "honest", make_chunk)
    assert asked.keys == []
    assert run.statistics().chunks == 5


@pytest.mark.parametrize("role", ["evaluator", "viewer"])
def test_only_an_actor_uploads(run: ChunkIntake, client: Client, make_chunk, role: str) -> None:
    with ChunkUploader(client(role), RUN, "intruder", new_incarnation(), capacity=4) as uploader:
        assert uploader.submit(make_chunk(), PATIENCE)
        deliver(client("actor"), "honest", make_chunk)
        assert uploader.statistics().acknowledged == 0
    assert run.statistics().chunks == 5
    assert run.statistics().invalid == {}


@pytest.mark.parametrize(
    ("role", "as_role"), [("actor", "learner"), ("actor", "evaluator"), ("viewer", "actor")]
)
def test_nobody_shows_up_as_another_role(
    run: ChunkIntake, client: Client, learner: zenoh.Session, sessions, role: str, as_role: str
) -> None:
    watcher = sessions.enter_context(PresenceWatcher(learner, RUN))
    session = client(role)
    sessions.enter_context(announce_presence(session, RUN, as_role, "impostor"))
    sessions.enter_context(announce_presence(client("actor"), RUN, "actor", "probe"))
    if role == "actor":
        sessions.enter_context(announce_presence(session, RUN, "actor", "own"))
        assert watcher.wait_for(lambda there: ("actor", "own") in there, PATIENCE)
    assert watcher.wait_for(lambda there: ("actor", "probe") in there, PATIENCE)
    assert (as_role, "impostor") not in watcher.present()


def test_actor_cannot_answer_for_the_learner(run: ChunkIntake, client: Client, received) -> None:
    asked = received()
    liar = client("actor")
    for key in (KEYS.run_file, KEYS.policy, "athrl/*/run-file"):
        liar.declare_queryable(key, asked, complete=True)
    assert fetch_run_file(client("viewer"), RUN, PATIENCE).run.name == RUN
    # Its own session asks too, whether its connection still answers; no question of another client may come.
    assert [key for key in asked.keys if key != PROBE_RUN_FILE] == []


def test_metrics_in_anothers_name_are_not_taken(run: ChunkIntake, client: Client, sessions) -> None:
    """Under its own key an actor may write; reports there in the name of another service are refused."""
    reports: list[MetricsReport] = []
    arrived = threading.Event()

    def take(report: MetricsReport) -> None:
        reports.append(report)
        arrived.set()

    sessions.enter_context(MetricsSubscriber(client("viewer"), RUN, take))
    actor = client("actor")
    liar = MetricsPublisher(actor, RUN, "actor", "liar")
    honest = MetricsPublisher(actor, RUN, "actor", "honest")
    liar._role = "learner"  # as a changed program would
    for _ in range(200):
        liar.publish({"updates": 1e9})
        honest.publish({"updates": 1.0})
        if arrived.wait(0.1):
            break
    assert reports
    assert {report.name for report in reports} == {"honest"}
