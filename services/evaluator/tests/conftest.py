"""A small untrained policy of the real planner, and a learner's announcements over real Zenoh."""

import json
import math
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from athrl_protocol import (
    EvaluationResult,
    EvaluationSubscriber,
    MetricsPublisher,
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

RUN_FILE = {
    "run": {"name": "test"},
    "environment": {"vehicles": 4, "episode_ticks": 40},
    "evaluator": {"episodes": 3, "final_episodes": 2, "seconds_between": 0.0, "recordings_kept": 8},
}


@pytest.fixture(scope="session")
def artefact() -> bytes:
    from athrl_planners import (
        ActionRange,
        AtHRL,
        ObservationSettings,
        PlannerSettings,
        PolicyExporter,
    )

    settings = PlannerSettings(
        hidden_features=16,
        recurrent_features=8,
        discount=0.97,
        learning_rate=3e-4,
        soft_target=0.005,
        reward_scale=0.02,
        saturation_penalty=0.02,
        twin_critics=True,
        actor_delay=2,
        target_noise=0.1,
        intention_gradient=1.0,
        gradient_norm=10.0,
        average_decay=0.99,
        burn_in=2,
    )
    speed = ActionRange("target_speed", "m/s", 0.0, 7.95, "ornstein-uhlenbeck", 0.2, 0.15)
    angle = ActionRange("waypoint_angle", "rad", -math.pi / 6, math.pi / 6, "gaussian", 0.1)
    intention = ActionRange("intention", "", 0.0, 2.0, "ornstein-uhlenbeck", 0.2, 0.15)
    actions = {"intention": (intention,), "trajectory": (speed, angle)}
    return PolicyExporter(AtHRL(settings, ObservationSettings(32), actions, seed=1)).artefact()


class Learner:
    """Announces a run and hears the results."""

    def __init__(self, address: str, artefact: bytes) -> None:
        self.address = address
        self.artefact = artefact
        self.run_file = RunFile.from_json(json.dumps(RUN_FILE))
        self.results: list[EvaluationResult] = []
        self.changed = threading.Condition()
        self._stack = ExitStack()

    def open(self) -> None:
        stack, run = self._stack, self.run_file.run.name
        self.session = stack.enter_context(open_session(listen=self.address, timeout=5))
        stack.enter_context(announce_presence(self.session, run, "learner", "learner"))
        stack.enter_context(serve_run_file(self.session, self.run_file))
        self.policies = stack.enter_context(PolicyPublisher(self.session, run))
        self.states = stack.enter_context(StatePublisher(self.session, run))
        self.metrics = stack.enter_context(MetricsPublisher(self.session, run, "learner", "learner"))
        self.presence = stack.enter_context(PresenceWatcher(self.session, run))
        stack.enter_context(EvaluationSubscriber(self.session, run, self._note))

    def close(self) -> None:
        self._stack.close()

    def publish(self, version: int, artefact: bytes | None = None) -> None:
        self.policies.publish(
            PolicyUpdate(
                version=version,
                artefact=self.artefact if artefact is None else artefact,
                uniform_exploration=False,
                noise_scale=1.0,
                updates=10 * version,
                environment_steps=100 * version,
                published_at=time.time(),
            )
        )

    def announce(self, phase: Phase, version: int) -> None:
        self.states.publish(RunState(phase, 100 * version, 1000, 10 * version, version))

    def wait_for(self, condition: Callable[[], bool], timeout: float = 60) -> bool:
        with self.changed:
            return self.changed.wait_for(condition, timeout)

    def wait_for_result(self, version: int) -> EvaluationResult:
        assert self.wait_for(lambda: any(result.policy_version == version for result in self.results))
        return next(result for result in self.results if result.policy_version == version)

    def _note(self, result: EvaluationResult) -> None:
        with self.changed:
            self.results.append(result)
            self.changed.notify_all()


@pytest.fixture
def learner(artefact: bytes) -> Iterator[Learner]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    learner = Learner(f"tcp/127.0.0.1:{port}", artefact)
    learner.open()
    yield learner
    learner.close()
