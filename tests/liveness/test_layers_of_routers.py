"""Routers behind routers: actors take part as at the learner, and nothing is lost when one is killed."""

from __future__ import annotations

import signal
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack

import pytest
from athrl_protocol import (
    Chunk,
    ChunkIntake,
    ChunkUploader,
    MetricsPublisher,
    MetricsReport,
    MetricsSubscriber,
    Phase,
    PolicyPublisher,
    PolicySubscriber,
    PolicyUpdate,
    PresenceWatcher,
    RunState,
    StatePublisher,
    announce_presence,
    join_run,
    new_incarnation,
    open_session,
    read_run_file,
    serve_run_file,
)

from benchmarks.experience import synthetic_chunk

RUN, ACTORS, CHUNKS, STEPS = "layers", 4, 150, 16
PATIENCE = 120.0
POLICY = PolicyUpdate(7, b"artefact", False, 1.0, 1, 1, 1.0)

pytestmark = pytest.mark.timeout(600)

Identity = tuple[str, int, int]


@pytest.fixture
def stack():
    with ExitStack() as stack:
        yield stack


@pytest.mark.slow
def test_chunks_through_two_layers_arrive_once_though_a_router_of_each_is_killed(
    command, stack: ExitStack, free_address: Callable[[], str], eventually
) -> None:
    learner, upper, lower = free_address(), free_address(), free_address()
    arrived: Counter[Identity] = Counter()
    reported: set[str] = set()

    def accept(chunk: Chunk) -> None:
        arrived[chunk.actor, chunk.incarnation, chunk.sequence] += 1

    def report(taken: MetricsReport) -> None:
        reported.add(taken.name)

    session = stack.enter_context(open_session(listen=learner, timeout=PATIENCE))
    stack.enter_context(serve_run_file(session, read_run_file(None, [f"run.name={RUN}"])))
    stack.enter_context(announce_presence(session, RUN, "learner", "learner"))
    stack.enter_context(PolicyPublisher(session, RUN)).publish(POLICY)
    stack.enter_context(MetricsSubscriber(session, RUN, report))
    present = stack.enter_context(PresenceWatcher(session, RUN))
    keep_telling(stack.enter_context(StatePublisher(session, RUN)), stack)
    intake = stack.enter_context(ChunkIntake(session, RUN, accept))

    def start(at: str, to: str):
        process = command.start("router", "--listen", at, "--connect", to, "--run", RUN)
        command.wait_until_said(process, "router for run", PATIENCE)
        return process

    above, below = start(upper, learner), start(lower, upper)
    uploaders = []
    for number in range(ACTORS):
        name = f"actor-{number}"
        joined = join_run(
            role="actor", connect=lower, run=RUN, name=name, stop=threading.Event(), stack=stack
        )
        assert joined is not None
        newest = stack.enter_context(PolicySubscriber(joined.session, RUN))
        eventually(lambda newest=newest: newest.newest() == POLICY, PATIENCE)
        stack.enter_context(MetricsPublisher(joined.session, RUN, "actor", name)).publish({"a": 1.0})
        uploaders.append(
            stack.enter_context(ChunkUploader(joined.session, RUN, name, new_incarnation(), capacity=256))
        )
    eventually(lambda: len(reported) == ACTORS, PATIENCE)
    assert sum(role == "actor" for role, _ in present.present()) == ACTORS

    chunk = synthetic_chunk(STEPS)
    submit(uploaders, chunk)
    for killed, at, to in ((above, upper, learner), (below, lower, upper)):
        killed.send_signal(signal.SIGKILL)
        killed.wait(30)
        submit(uploaders, chunk, most=32)  # while nothing passes
        start(at, to)
        submit(uploaders, chunk)
    for uploader in uploaders:
        uploader.flush(PATIENCE)
        counts = uploader.statistics()
        assert (counts.given_up, counts.waiting) == (0, 0)
    acknowledged = sum(uploader.statistics().acknowledged for uploader in uploaders)
    assert acknowledged == ACTORS * (3 * CHUNKS + 2 * 32)
    assert len(arrived) == intake.statistics().stored == acknowledged
    assert set(arrived.values()) == {1}


def submit(uploaders: list[ChunkUploader], chunk: Chunk, most: int = CHUNKS) -> None:
    """Have every uploader take a number of chunks; each waits until it has room."""
    for uploader in uploaders:
        for _ in range(most):
            deadline = time.monotonic() + PATIENCE
            while not uploader.submit(chunk, 1.0):
                assert time.monotonic() < deadline


def keep_telling(states: StatePublisher, stack: ExitStack) -> None:
    """Tell the state of the run once a second, as a learner does."""
    stop = threading.Event()

    def tell() -> None:
        while not stop.wait(1.0):
            states.publish(RunState(Phase.TRAINING, 1, 2, 3, POLICY.version))

    thread = threading.Thread(target=tell)
    thread.start()
    stack.callback(thread.join, 30)
    stack.callback(stop.set)
