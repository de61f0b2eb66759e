"""Memory that one connection takes of a learner and of a router."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from athrl.ports import free_address
from athrl_learner import factories
from athrl_learner.components import make_experience
from athrl_learner.intake.arrivals import Arrivals
from athrl_protocol import ChunkIntake, RunFile, open_session

from benchmarks.crowd import Crowd, news
from benchmarks.light_crowd import RUN, resident_mebibytes
from benchmarks.scale.processes import PATIENCE, reading, router

_SETTLED_SECONDS = 5.0
_PROCESSES = 2


@dataclass(frozen=True)
class Connected:
    """MiB for each actor that has joined and sends nothing, of the process that it is connected to."""

    actors: int
    learner_mebibytes: float
    router_mebibytes: float


def connect(run_file: RunFile, actors: int, folder: Path) -> Connected:
    """Let actors join at a learner, and as many others at a router."""
    folder.mkdir()
    store = make_experience(
        run_file, factories.make_agent(run_file), Arrivals(), factories.make_log(run_file, folder / "log")
    )
    address, behind = free_address(), free_address()
    with (
        contextlib.closing(store.log),
        open_session(listen=address, timeout=PATIENCE) as session,
        news(session, run_file, store, Arrivals()),
        ChunkIntake(session, RUN, store),
    ):
        alone = resident_mebibytes()
        with _joined(address, actors):
            at_learner = (resident_mebibytes() - alone) / actors
        with router(behind, address, RUN, folder / "router.log") as process:
            alone = reading(process).mebibytes
            with _joined(behind, actors):
                at_router = (reading(process).mebibytes - alone) / actors
    return Connected(actors, at_learner, at_router)


@contextlib.contextmanager
def _joined(address: str, actors: int) -> Iterator[None]:
    """Actors that have joined at an address, a moment ago."""
    with contextlib.closing(Crowd(address, actors, _PROCESSES, 1.0)) as crowd:
        crowd.join()
        time.sleep(_SETTLED_SECONDS)
        yield
