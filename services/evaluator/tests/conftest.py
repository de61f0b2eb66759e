"""A small untrained policy of the real planner, and a learner's announcements over real Zenoh."""

import json
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
    "replay": {"sequence_length": 4},
    "evaluator": {"episodes": 3, "final_episodes": 2, "seconds_between": 0.0, "recordings_kept": 8},
}


def untrained(kind: str, **settings: object) -> bytes:
    """A small policy of one of the real planners."""
    from athrl_planners import PolicyExporter, make_agent

    values = {"hidden_features": 16, "head_features": 16, **settings}
    return PolicyExporter(make_agent(kind, values, seed=1)).artefact()


@pytest.fixture(scope="session")
def artefact() -> bytes:
    return untrained("athrl", memory="lstm", recurrent_features=8)


@pytest.fixture(scope="session")
def artefacts() -> dict[str, bytes]:
    """Policies without memory, of planners with other levels or actions, by their kind."""
    return {kind: untrained(kind) for kind in ("hddpg", "ddpg", "hdqn")}


class Learner:
    """Announces a run and receives the results."""

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

    def serve(self, **environment: object) -> None:
        """Serve a run file with other settings of the environment."""
        section = self.run_file.environment.model_copy(update=environment)
        self.run_file = self.run_file.model_copy(update={"environment": section})
        self.close()
        self.open()

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

    def wait_for(self, condition: Callable[[], bool], timeout: float = 150) -> bool:
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
def learner(artefact: bytes, address: str) -> Iterator[Learner]:
    learner = Learner(address, artefact)
    learner.open()
    yield learner
    learner.close()
