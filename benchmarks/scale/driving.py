"""Real actors in racks: what their decisions cost the learner and the lines between them."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from athrl.run_view import RunSnapshot, RunView
from athrl_protocol import RunState

from benchmarks.scale.processes import PATIENCE, athrl, reading
from benchmarks.scale.racks import Rack

RUN = "scale"
_PORT = 17_450
_JOINED_WITHIN = 900.0
_GIVES_WAY = 10
_SETTINGS = {
    "run.environment_steps": 1_000_000_000,
    "environment.vehicles": 5,
    "exploration.random_decisions": 100,
    "actor.environments": 4,
    # Hardly any training: what is measured is what actors cost a learner, not what it learns.
    "learner.samples_per_insert": 0.01,
    "learner.threads": 1,
    "replay.capacity": 20_000,
}


@dataclass(frozen=True)
class Driven:
    """What real actors delivered, and what it cost.

    Attributes:
        actors: that took part when it ended.
        decisions: taken in while it was measured.
        per_second: of them.
        learner_cpu: seconds of a core of the learner, whole process, for 1,000 decisions.
        bytes_a_decision: that came from the racks, with the headers of IP and TCP.
        bytes_to_an_actor: that went to one actor in a second.
        policies: published while it was measured.
        policy_bytes: of one published policy.
    """

    actors: int
    decisions: int
    per_second: float
    learner_cpu: float
    bytes_a_decision: float
    bytes_to_an_actor: float
    policies: int
    policy_bytes: int


def drive(racks: Sequence[Rack], actors: int, seconds: float, folder: Path) -> Driven:
    """Run a learner here and actors in the racks; nothing that was acknowledged may be lost meanwhile."""
    folder.mkdir()
    given = {**_SETTINGS, "run.name": RUN, "run.folder": str(folder / "runs")}
    settings = [word for key, value in given.items() for word in ("--set", f"{key}={value}")]
    listen = f"network.listen=tcp/0.0.0.0:{_PORT}"
    with ExitStack() as stack:
        learner = stack.enter_context(athrl(["learner", *settings, "--set", listen], folder / "learner.log"))
        view = stack.enter_context(RunView(f"tcp/127.0.0.1:{_PORT}", RUN, timeout=PATIENCE))
        processes = []
        for number in range(actors):
            rack = racks[number % len(racks)]
            where = ["actor", "--connect", f"tcp/{rack.here}:{_PORT}", "--run", RUN]
            log = folder / f"actor-{number}.log"
            # They give way to the learner and the lines, which on machines of their own they would not meet.
            within = [*rack.within, "nice", "-n", str(_GIVES_WAY)]
            words = [*where, "--name", f"actor-{number}"]
            processes.append(stack.enter_context(athrl(words, log, within)))
        stack.callback(lambda: [process.terminate() for process in processes])  # all at once
        _await_all(view.snapshot, actors)
        before, began = view.snapshot(), time.perf_counter()
        cost, came, went = reading(learner).cpu, *_bytes(racks)
        time.sleep(seconds)
        after, elapsed = view.snapshot(), time.perf_counter() - began
        cost = reading(learner).cpu - cost
        came, went = (now - then for now, then in zip(_bytes(racks), (came, went), strict=True))
        if lost := after.learner_metric("intake/lost"):
            sys.exit(f"{lost:,.0f} chunks that were acknowledged are not in the log, should be none")
        policy = (folder / "runs" / RUN / "policies" / "latest.onnx").stat().st_size
    decisions = _state(after).environment_steps - _state(before).environment_steps
    return Driven(
        actors=len(after.of_role("actor")),
        decisions=decisions,
        per_second=decisions / elapsed,
        learner_cpu=cost / decisions * 1000,
        bytes_a_decision=came / decisions,
        bytes_to_an_actor=went / elapsed / actors,
        policies=_state(after).policy_version - _state(before).policy_version,
        policy_bytes=policy,
    )


def _await_all(snapshot: Callable[[], RunSnapshot], actors: int) -> None:
    """Wait until every actor has driven: its report said that chunks were acknowledged."""
    deadline, delivered = time.monotonic() + _JOINED_WITHIN, set[str]()
    while True:
        reports = snapshot().of_role("actor").items()
        delivered |= {name for name, report in reports if report.get("chunks_acknowledged", 0) > 0}
        if len(delivered) >= actors:
            return
        if time.monotonic() > deadline:
            sys.exit(f"{len(delivered)} of {actors} actors had delivered within {_JOINED_WITHIN:.0f} s")
        time.sleep(1.0)


def _state(snapshot: RunSnapshot) -> RunState:
    assert snapshot.state is not None
    return snapshot.state


def _bytes(racks: Sequence[Rack]) -> tuple[int, int]:
    return sum(rack.bytes_received() for rack in racks), sum(rack.bytes_sent() for rack in racks)
