"""A small run on a free port of this machine, and chunks that fit it."""

import contextlib
import importlib.util
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Self

import numpy as np
import pytest
from athrl_learner import factories
from athrl_learner.intake.store import ExperienceStore
from athrl_learner.log import SegmentLog
from athrl_planners import settings_tables
from athrl_protocol import (
    Chunk,
    ChunkUploader,
    LevelColumns,
    MetricsReport,
    MetricsSubscriber,
    Phase,
    PolicySubscriber,
    PolicyUpdate,
    RunFile,
    RunState,
    StateSubscriber,
    UploadStatistics,
    announce_presence,
    encode_chunk,
    fetch_run_file,
    new_incarnation,
    open_session,
    read_run_file,
)
from athrl_protocol.run_file import declare_planners

declare_planners(settings_tables())

TIME = 5
STATE = 16  # h and c of 8 recurrent features

SETTINGS = (
    "run.name=small",
    "run.environment_steps=400",
    "planner.hidden_features=16",
    "planner.head_features=16",
    "planner.intention_features=16",
    "planner.atoms=11",
    "planner.memory=lstm",
    "planner.recurrent_features=8",
    "planner.shared_trunk=false",
    "exploration.random_decisions=60",
    "replay.capacity=1000",
    f"replay.sequence_length={TIME}",
    "replay.burn_in=1",
    f"learner.batch={4 * TIME}",
    "learner.threads=1",
    "learner.precision=float32",
    "learner.samples_per_insert=4",
    "learner.publish_seconds=0.1",
    "learner.checkpoint_seconds=0.5",
    "durability.segment_mebibytes=0.1",
)


@pytest.fixture(scope="session")
def run_file_in(free_address: Callable[[], str]) -> Callable[[Path], RunFile]:
    """The small run in a folder, at an address of its own."""

    def make(folder: Path) -> RunFile:
        return read_run_file(None, [*SETTINGS, f"run.folder={folder}", f"network.listen={free_address()}"])

    return make


@pytest.fixture
def run_file(tmp_path: Path, address: str) -> RunFile:
    return read_run_file(None, [*SETTINGS, f"run.folder={tmp_path}", f"network.listen={address}"])


@pytest.fixture
def make_chunk() -> Callable[..., Chunk]:
    """Make a chunk that fits the small run, with random content; keywords replace its fields."""
    random = np.random.default_rng(0)

    def make(sequences: int = 1, **fields: object) -> Chunk:
        time = sequences * TIME
        length = int(fields.get("length", time))
        levels = {
            "intention": random.uniform(0, 2, (time, 1)),
            "trajectory": np.stack(
                [random.uniform(0, 7.95, time), random.uniform(-0.52, 0.52, time)], axis=1
            ),
        }
        return Chunk(
            **{
                "actor": "actor-1",
                "incarnation": 1,
                "sequence": 0,
                "environment": 0,
                "episode_seed": 7,
                "first_step": 0,
                "length": length,
                "state_interval": TIME,
                "images": random.integers(0, 2, (time + 1, 32, 32, 4), dtype=np.uint8) * np.uint8(255),
                "motion": random.uniform(-1, 1, (time + 1, 2)).astype(np.float32),
                "levels": {
                    name: LevelColumns(
                        actions=actions.astype(np.float32),
                        rewards=random.normal(size=time).astype(np.float32),
                        states=random.normal(size=(sequences, STATE)).astype(np.float32),
                    )
                    for name, actions in levels.items()
                },
                "policy_version": np.zeros(time, np.int64),
                "terminated": False,
                "truncated": False,
                **fields,
            }
        )

    return make


@pytest.fixture(scope="session")
def faults() -> ModuleType:
    """The module `faults.py`, with disks that fail."""
    spec = importlib.util.spec_from_file_location("faults", Path(__file__).with_name("faults.py"))
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    assert spec.loader is not None
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def wait_for() -> Callable[[Callable[[], bool]], None]:
    """Wait until something has happened that must happen."""

    def wait(condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + 150
        while not condition():
            assert time.monotonic() < deadline, "the awaited did not happen"
            time.sleep(0.01)

    return wait


@pytest.fixture
def experience(run_file: RunFile, tmp_path: Path) -> Iterator[SegmentLog]:
    """The log of experience of the small run, in a separate folder."""
    log = factories.make_log(run_file, tmp_path / "experience")
    yield log
    log.close()


@pytest.fixture
def accept() -> Callable[[ExperienceStore, Chunk], None]:
    """Hand a chunk to a store as the intake does."""
    return lambda store, chunk: store.accept(chunk, encode_chunk(chunk))


class FakeActor:
    """Drives nothing, but speaks the whole protocol: reads the run file, gets policies, uploads chunks."""

    def __init__(self, address: str, make_chunk: Callable[..., Chunk], name: str = "actor-1") -> None:
        self._address = address
        self._make_chunk = make_chunk
        self._name = name
        self._leave = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self.policies: list[PolicyUpdate] = []
        self.states: list[RunState] = []
        self.metrics: list[MetricsReport] = []
        self.finished = False
        self.statistics: UploadStatistics | None = None

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._leave.set()
        self._thread.join(timeout=150)
        assert not self._thread.is_alive()

    def wait_for(self, condition: Callable[[], bool]) -> None:
        """Wait until something has happened that must happen."""
        deadline = time.monotonic() + 150
        while not condition():
            assert time.monotonic() < deadline, "the awaited did not happen"
            time.sleep(0.02)

    def _live(self) -> None:
        with contextlib.ExitStack() as stack:
            session = stack.enter_context(open_session(connect=self._address, timeout=30))
            run = fetch_run_file(session, "small", timeout=30).run.name
            stack.enter_context(announce_presence(session, run, "actor", self._name))
            stack.enter_context(PolicySubscriber(session, run, self.policies.append))
            stack.enter_context(StateSubscriber(session, run, self.states.append))
            stack.enter_context(MetricsSubscriber(session, run, self.metrics.append))
            uploader = ChunkUploader(session, run, self._name, new_incarnation(), capacity=16)
            stack.enter_context(uploader)
            self.wait_for(lambda: bool(self.policies) or self._leave.is_set())
            while not self._leave.is_set() and not uploader.finished:
                version = np.full(TIME, self.policies[-1].version, np.int64)
                uploader.submit(self._make_chunk(policy_version=version), timeout=0.1)
            self.statistics = uploader.statistics()
            if uploader.finished:
                self.wait_for(self._has_heard_the_end)
                self.finished = True

    def _has_heard_the_end(self) -> bool:
        state = self.states[-1]
        return state.phase is Phase.FINISHED and self.policies[-1].version == state.policy_version


@pytest.fixture
def make_actor(address: str) -> Callable[..., FakeActor]:
    """An actor of the small run that sends what the given function makes, under a name."""
    return lambda make, name: FakeActor(address, make, name)


@pytest.fixture
def fake_actor(address: str, make_chunk: Callable[..., Chunk]) -> FakeActor:
    return FakeActor(address, make_chunk)
