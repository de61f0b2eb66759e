"""A learner that receives chunks over real Zenoh, and a policy that needs no training."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import onnx
import onnx.parser
import pytest
from athrl_driving.policy import EnvironmentBatch
from athrl_protocol import (
    Chunk,
    ChunkIntake,
    IntakeBusy,
    IntakeFinished,
    MetricsReport,
    MetricsSubscriber,
    Phase,
    PolicyPublisher,
    PolicyUpdate,
    PresenceWatcher,
    RunFile,
    RunState,
    StatePublisher,
    announce_presence,
    open_session,
    serve_run_file,
)
from athrl_spaces import (
    WAYPOINT,
    WAYPOINT_SET,
    Continuous,
    Epsilon,
    LevelDescription,
    Limits,
    Noise,
    Observation,
    PolicyDescription,
    action_kind,
)

RUN_FILE = {
    "run": {"name": "test"},
    "environment": {"vehicles": 4, "episode_ticks": 36},
    "replay": {"sequence_length": 4},
    "actor": {"environments": 2, "unacknowledged_chunks": 8, "sequences_per_chunk": 2},
}

NOISE, EPSILON = Noise(0.1, 0.3), Epsilon(0.1, 0.5)
TARGET_SPEED, WAYPOINT_ANGLE = action_kind(WAYPOINT).describe(Limits())
BEHAVIOUR, PLACE = action_kind(WAYPOINT_SET).describe(Limits())

REMEMBERING = PolicyDescription(
    planner="test",
    action_kind=WAYPOINT,
    limits=Limits(),
    observation=Observation(32),
    levels=(
        LevelDescription("intention", (Continuous("intention", "", 0.0, 2.0, NOISE),), 3),
        LevelDescription(
            "trajectory",
            (replace(TARGET_SPEED, exploration=NOISE), replace(WAYPOINT_ANGLE, exploration=NOISE)),
            2,
        ),
    ),
)
CHOOSING = PolicyDescription(
    planner="test",
    action_kind=WAYPOINT_SET,
    limits=Limits(),
    observation=Observation(32),
    levels=(
        LevelDescription(
            "choice", (replace(BEHAVIOUR, exploration=EPSILON), replace(PLACE, exploration=EPSILON))
        ),
    ),
)

# Drives straight ahead; the states count the decisions of an episode, so the content of a chunk is known.
REMEMBERING_GRAPH = """
<ir_version: 8, opset_import: ["" : 17]>
policy (uint8[N,32,32,4] image, float[N,2] motion, float[N,3] intention_state, float[N,2] trajectory_state,
        float[N,1] intention_noise, float[N,1] forced_intention,
        float[N,2] trajectory_noise, float[N,2] forced_trajectory)
    => (float[N,1] intention, float[N,2] trajectory,
        float[N,3] next_intention_state, float[N,2] next_trajectory_state)
{
    one = Constant <value_float: float = 1.0> ()
    two = Constant <value_float: float = 2.0> ()
    nothing = Constant <value_float: float = 0.0> ()
    pixels = Cast <to: int = 1> (image)
    bright = ReduceMean <axes: ints = [1, 2, 3], keepdims: int = 0> (pixels)
    row = Unsqueeze (bright, axis)
    unlit = Mul (row, nothing)
    plain = Add (unlit, one)
    noisy = Add (plain, intention_noise)
    free = IsNaN (forced_intention)
    chosen = Where (free, noisy, forced_intention)
    intention = Clip (chosen, nothing, two)
    speed = Add (intention, two)
    still = ReduceMean <axes: ints = [1], keepdims: int = 1> (motion)
    angle = Mul (still, nothing)
    planned = Concat <axis: int = 1> (speed, angle)
    noisy_plan = Add (planned, trajectory_noise)
    free_plan = IsNaN (forced_trajectory)
    chosen_plan = Where (free_plan, noisy_plan, forced_trajectory)
    above_low = Max (chosen_plan, low)
    trajectory = Min (above_low, high)
    next_intention_state = Add (intention_state, one)
    next_trajectory_state = Add (trajectory_state, two)
}
"""

# Drives at full speed to the waypoint just left of straight ahead; has no memory.
CHOOSING_GRAPH = """
<ir_version: 8, opset_import: ["" : 17]>
policy (uint8[N,32,32,4] image, float[N,2] motion, float[N,2] forced_choice) => (float[N,2] choice)
{
    nothing = Constant <value_float: float = 0.0> ()
    pixels = Cast <to: int = 1> (image)
    bright = ReduceMean <axes: ints = [1, 2, 3], keepdims: int = 0> (pixels)
    row = Unsqueeze (bright, axis)
    unlit = Mul (row, nothing)
    still = Mul (motion, nothing)
    nowhere = Add (unlit, still)
    fixed = Add (nowhere, favourite)
    free = IsNaN (forced_choice)
    choice = Where (free, fixed, forced_choice)
}
"""
FAVOURITE = np.array([2.0, 11.0], np.float32)


def make_artefact(description: PolicyDescription) -> bytes:
    model = onnx.parser.parse_model(REMEMBERING_GRAPH if description.levels[0].state_size else CHOOSING_GRAPH)
    constants = {"axis": np.array([1])}
    if description.levels[0].state_size:
        constants |= {"low": description.levels[1].low, "high": description.levels[1].high}
    else:
        constants["favourite"] = FAVOURITE
    for name, value in constants.items():
        model.graph.initializer.append(onnx.numpy_helper.from_array(value, name))
    onnx.helper.set_model_props(model, {"athrl": description.to_json()})
    return model.SerializeToString()


class Learner:
    """Serves a run, stores received chunks, and can be busy, full, finished or away."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.run_file = RunFile.from_json(json.dumps(RUN_FILE))
        self.chunks: list[Chunk] = []
        self.reports: list[MetricsReport] = []
        self.full = False
        self.finished = False
        self.answers = threading.Event()  # cleared: it is too busy to answer
        self.answers.set()
        self.version = 0
        self.changed = threading.Condition()
        self.ledger: dict | None = None
        self._stack = ExitStack()

    def open(self) -> None:
        stack = self._stack = ExitStack()
        run = self.run_file.run.name
        self.session = stack.enter_context(open_session(listen=self.address, timeout=5))
        stack.enter_context(announce_presence(self.session, run, "learner", "learner"))
        stack.enter_context(serve_run_file(self.session, self.run_file))
        self.policies = stack.enter_context(PolicyPublisher(self.session, run))
        self.states = stack.enter_context(StatePublisher(self.session, run))
        self.presence = stack.enter_context(PresenceWatcher(self.session, run))
        stack.enter_context(MetricsSubscriber(self.session, run, self._note))
        self.intake = stack.enter_context(ChunkIntake(self.session, run, self._accept, self.ledger))

    def close(self) -> None:
        self.ledger = self.intake.ledger()
        self._stack.close()

    def publish(
        self,
        version: int,
        *,
        uniform: bool = False,
        noise_scale: float = 1.0,
        choosing: bool = False,
    ) -> None:
        self.version = version
        self.policies.publish(
            PolicyUpdate(
                version=version,
                artefact=make_artefact(CHOOSING if choosing else REMEMBERING),
                uniform_exploration=uniform,
                noise_scale=noise_scale,
                updates=0,
                environment_steps=0,
                published_at=time.time(),
            )
        )

    def announce(self, phase: Phase) -> None:
        steps = sum(chunk.length for chunk in self.chunks)
        self.states.publish(RunState(phase, steps, 1000, 0, self.version))

    def wait_for(self, condition: Callable[[], bool], timeout: float = 60) -> bool:
        with self.changed:
            return self.changed.wait_for(condition, timeout)

    def wait_for_chunks(self, count: int) -> None:
        assert self.wait_for(lambda: len(self.chunks) >= count)

    def _accept(self, chunk: Chunk) -> None:
        self.answers.wait(60)
        with self.changed:
            if self.finished:
                raise IntakeFinished
            if self.full:
                raise IntakeBusy
            self.chunks.append(chunk)
            self.changed.notify_all()

    def _note(self, report: MetricsReport) -> None:
        with self.changed:
            self.reports.append(report)
            self.changed.notify_all()


@pytest.fixture(scope="session", autouse=True)
def compiled_town() -> None:
    """Compile the simulation before waiting for an actor, as it takes long once."""
    EnvironmentBatch(["town03"], {"vehicles_count": 1}).close()


@pytest.fixture
def learner(address: str) -> Iterator[Learner]:
    learner = Learner(address)
    learner.open()
    yield learner
    learner.close()
