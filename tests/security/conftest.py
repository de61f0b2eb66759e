"""What the tests of security share: two authorities, and a learner's session that knows services by one."""

from __future__ import annotations

import contextlib
import shutil
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh
from athrl.certificates import make_all
from athrl_protocol import Chunk, LevelColumns, open_session
from athrl_protocol.security.certificates import ROLES

PATIENCE = 30.0
RUN = "guarded"
LARGEST_CHUNK = 2**18


@pytest.fixture(scope="session")
def _authorities(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folders = {name: tmp_path_factory.mktemp(name) / "certificates" for name in ("ours", "foreign")}
    for folder in folders.values():
        make_all(folder, ["127.0.0.1", "localhost"], days=2)
    return folders


@pytest.fixture
def ours(_authorities: dict[str, Path], tmp_path: Path) -> Path:
    """Certificates of the run's authority; a copy, which a test may change."""
    return Path(shutil.copytree(_authorities["ours"], tmp_path / "ours"))


@pytest.fixture
def foreign(_authorities: dict[str, Path]) -> Path:
    """Certificates of another authority."""
    return _authorities["foreign"]


@pytest.fixture
def sessions() -> Iterator[contextlib.ExitStack]:
    """Closes at the end what was opened."""
    with contextlib.ExitStack() as stack:
        yield stack


@pytest.fixture
def unused_port(free_port: Callable[[], int]) -> int:
    """Another port of the loopback interface that is free."""
    return free_port()


@pytest.fixture
def learner(sessions: contextlib.ExitStack, ours: Path, port: int) -> zenoh.Session:
    """A learner's session with its access list."""
    return sessions.enter_context(
        open_session(
            listen=f"tls/127.0.0.1:{port}",
            timeout=PATIENCE,
            run=RUN,
            certificates=ours,
            largest_chunk=LARGEST_CHUNK,
        )
    )


@pytest.fixture
def client(
    learner: zenoh.Session, sessions: contextlib.ExitStack, ours: Path, port: int
) -> Callable[[str], zenoh.Session]:
    """Connects with a role's certificate."""

    def connect(role: str) -> zenoh.Session:
        assert role in ROLES
        session = open_session(
            connect=f"tls/127.0.0.1:{port}", timeout=PATIENCE, role=role, certificates=ours / role
        )
        return sessions.enter_context(session)

    return connect


class Received:
    """Samples and queries that arrived somewhere."""

    def __init__(self) -> None:
        self._arrived = threading.Condition()
        self.keys: list[str] = []
        self.payloads: set[bytes] = set()

    def __call__(self, what: zenoh.Sample | zenoh.Query) -> None:
        with self._arrived:
            self.keys.append(str(what.key_expr))
            if what.payload is not None:
                self.payloads.add(what.payload.to_bytes())
            self._arrived.notify_all()

    def wait(self, key: str) -> None:
        """Wait until something arrived under the key."""
        with self._arrived:
            assert self._arrived.wait_for(lambda: key in self.keys, PATIENCE), self.keys


@pytest.fixture
def received() -> Callable[[], Received]:
    return Received


@pytest.fixture
def make_chunk() -> Callable[[], Chunk]:
    """Makes a small valid chunk."""

    def floats(*shape: int) -> np.ndarray:
        return np.zeros(shape, np.float32)

    def make() -> Chunk:
        return Chunk(
            actor="unset",
            incarnation=0,
            sequence=0,
            environment=0,
            episode_seed=1,
            first_step=0,
            length=4,
            state_interval=4,
            images=np.zeros((5, 8, 8, 4), np.uint8),
            motion=floats(5, 2),
            levels={"intention": LevelColumns(floats(4, 1), floats(4), floats(1, 6))},
            policy_version=np.zeros(4, np.int64),
            terminated=False,
            truncated=False,
        )

    return make
