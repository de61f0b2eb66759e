"""What the protocol's tests share: another address, sessions that are closed, and chunks with content."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
import zenoh
from athrl_protocol import Chunk, LevelColumns, open_session
from athrl_protocol.run_file import declare_planners, declared_planners

# Far longer than anything here takes on a busy machine; a wait ends as soon as what it waits for is there.
PATIENCE = 30.0


@pytest.fixture(autouse=True)
def no_planners() -> Iterator[None]:
    """No planners are declared, and declarations of a test end with it."""
    before = declared_planners()
    declare_planners({})
    yield
    declare_planners(before)


@pytest.fixture
def other_address(free_address: Callable[[], str]) -> str:
    return free_address()


@pytest.fixture
def sessions(address: str) -> Iterator[contextlib.ExitStack]:
    """Closes at the end what was opened by the other fixtures."""
    with contextlib.ExitStack() as stack:
        yield stack


@pytest.fixture
def listen(address: str, sessions: contextlib.ExitStack) -> Callable[[], zenoh.Session]:
    """Opens a learner's session; again after it was closed."""
    return lambda: sessions.enter_context(open_session(listen=address, timeout=PATIENCE))


@pytest.fixture
def connect(address: str, sessions: contextlib.ExitStack) -> Callable[[], zenoh.Session]:
    """Opens a client's session to the learner's."""
    return lambda: sessions.enter_context(open_session(connect=address, timeout=PATIENCE))


@pytest.fixture
def eventually() -> Callable[[Callable[[], bool]], None]:
    """Waits until a condition holds."""

    def wait(condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, "it did not become true"
            time.sleep(0.005)

    return wait


@pytest.fixture
def make_chunk() -> Callable[..., Chunk]:
    """Makes a small chunk whose first reward is `mark`, so that chunks can be told apart."""

    def make(mark: float = 0.0, time: int = 4, length: int | None = None) -> Chunk:
        random = np.random.default_rng(int(mark))

        def floats(*shape: int) -> np.ndarray:
            return random.standard_normal(shape).astype(np.float32)

        rewards = floats(time)
        rewards[0] = mark
        return Chunk(
            actor="unset",
            incarnation=0,
            sequence=0,
            environment=3,
            episode_seed=2**40 + 1,
            first_step=8,
            length=time if length is None else length,
            state_interval=time,
            images=random.integers(0, 256, (time + 1, 8, 8, 4), dtype=np.uint8),
            motion=floats(time + 1, 2),
            levels={
                "intention": LevelColumns(floats(time, 1), rewards, floats(1, 6)),
                "trajectory": LevelColumns(floats(time, 2), floats(time), floats(1, 6)),
            },
            policy_version=np.arange(time, dtype=np.int64),
            terminated=False,
            truncated=True,
        )

    return make
