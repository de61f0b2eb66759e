"""The learner notices other processes that answer or publish under its keys, and no honest client."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator

import pytest
import zenoh
from athrl_protocol import (
    Chunk,
    ChunkIntake,
    ChunkUploader,
    Keys,
    Phase,
    PolicyPublisher,
    PolicySubscriber,
    PolicyUpdate,
    RivalWatch,
    RunFile,
    RunState,
    StatePublisher,
    StateSubscriber,
    new_incarnation,
    serve_run_file,
)
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.schema import encode_message
from athrl_protocol.transport.session import open_router

RUN = RunFile().run.name
KEYS = Keys(RUN)
STATE = RunState(Phase.TRAINING, 1, 2, 3, 1)
PATIENCE = 30.0
Open = Callable[[], zenoh.Session]
Eventually = Callable[[Callable[[], bool]], None]


@pytest.fixture
def rivals(listen: Open) -> Iterator[RivalWatch]:
    """Watches in a session that answers and publishes as a learner's does."""
    session = listen()
    with (
        serve_run_file(session, RunFile()),
        PolicyPublisher(session, RUN) as policies,
        StatePublisher(session, RUN) as states,
        ChunkIntake(session, RUN, lambda chunk: None),
        RivalWatch(session, RUN, policies, states) as watch,
    ):
        policies.publish(PolicyUpdate(1, b"onnx", False, 1.0, 1, 1, 1.0))
        states.publish(STATE)
        yield watch


@pytest.mark.parametrize(
    "key", [KEYS.experience("rig"), KEYS.every_experience, f"athrl/{RUN}/**", KEYS.run_file, KEYS.policy]
)
def test_second_answerer_is_named_once_while_it_stays(
    rivals: RivalWatch, connect: Open, eventually: Eventually, caplog: pytest.LogCaptureFixture, key: str
) -> None:
    rivals.check(["rig", "other"])
    assert rivals.answerers == 0
    session = connect()
    answerer = session.declare_queryable(key, lambda query: query.drop(), complete=True)
    eventually(lambda: _answers(rivals))
    rivals.check(["rig", "other"])  # the first check may have come between two keys
    found = rivals.answerers
    lines = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert all(line.startswith(f"another process answers at athrl/{RUN}/") for line in lines)
    for _ in range(3):
        rivals.check(["rig", "other"])
    assert rivals.answerers == found
    assert len(caplog.records) == len(lines) <= 2
    answerer.undeclare()
    time.sleep(0.1)
    rivals.check(["rig"])
    session.declare_queryable(key, lambda query: query.drop(), complete=True)
    eventually(lambda: _answers(rivals, more_than=found))


def _answers(rivals: RivalWatch, more_than: int = 0) -> bool:
    rivals.check(["rig", "other"])
    return rivals.answerers > more_than


@pytest.mark.parametrize("key", [KEYS.policy, KEYS.state, KEYS.run_file])
def test_value_of_another_is_counted_and_named(
    rivals: RivalWatch, connect: Open, eventually: Eventually, caplog: pytest.LogCaptureFixture, key: str
) -> None:
    session = connect()
    for _ in range(3):
        session.put(key, b"forged", congestion_control=zenoh.CongestionControl.BLOCK)
    eventually(lambda: rivals.values == 3)
    assert [record.getMessage() for record in caplog.records if key in record.getMessage()] == [
        f"another process publishes under {key}: actors and evaluators may believe it"
    ]


def test_value_of_another_is_replaced_by_the_learners_own(
    rivals: RivalWatch, connect: Open, eventually: Eventually
) -> None:
    """Also for a later subscriber."""
    with StateSubscriber(connect(), RUN) as states:
        assert states.wait(PATIENCE) == STATE
        rogue = connect()
        later = athrl_pb2.Version(incarnation=new_incarnation() + 3_600 * 10**9, number=7)
        ended = athrl_pb2.RunState(phase=athrl_pb2.RunState.FINISHED)
        rogue.put(KEYS.state, encode_message(ended), attachment=encode_message(later))
        eventually(lambda: states.newest() != STATE)

        def replaced() -> bool:
            rivals.check([])
            return states.newest() == STATE

        eventually(replaced)
        with StateSubscriber(connect(), RUN) as late:
            assert late.wait(PATIENCE) == STATE


def test_clients_and_a_router_are_no_rivals(
    rivals: RivalWatch,
    address: str,
    other_address: str,
    connect: Open,
    make_chunk: Callable[..., Chunk],
) -> None:
    with open_router(listen=other_address, connect=address, run=RUN):
        actor = connect()
        with (
            PolicySubscriber(actor, RUN) as policies,
            ChunkUploader(actor, RUN, "rig", new_incarnation(), capacity=8) as uploader,
        ):
            assert policies.wait(PATIENCE) is not None
            assert uploader.submit(make_chunk(), PATIENCE)
            assert uploader.flush(PATIENCE)
            rivals.check(["rig"])
    assert (rivals.answerers, rivals.values) == (0, 0)
