"""Does what a fault says to the run, and says when those it hit do their work again."""

from __future__ import annotations

import random
import re
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from athrl_learner.checkpoint.content import AGENT, MANIFEST, STATE, numbered_checkpoints

from tests.chaos.cutter import Link
from tests.chaos.evidence import Evidence
from tests.chaos.flood import Flood, flood, strangers
from tests.chaos.observer import Observer
from tests.chaos.processes import Service
from tests.chaos.run import EVALUATOR, LEARNER, StormyRun
from tests.chaos.schedule import Fault, Kind

_STOP_SECONDS = 90.0
_SLOWEST_SECONDS = 0.2
_METRICS_SECONDS = 2.5


@dataclass
class Faults:
    """Everything that faults are done to, and what they came to.

    Attributes:
        floods: what became of their messages.
        turned_away: connections of strangers, by what they lacked.
        damaged: names of the checkpoints that were damaged.
        failures: what a fault showed to be wrong, one line each.
    """

    run: StormyRun
    services: dict[str, Service]
    links: dict[str, Link]
    observer: Observer
    evidence: Evidence
    floods: list[Flood] = field(default_factory=list)
    turned_away: dict[str, int] = field(default_factory=dict)
    damaged: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def happen(self, fault: Fault) -> None:
        """Let the fault begin and end; what died is started again."""
        service = self.services[fault.target]
        match fault.kind:
            case Kind.LEARNER_KILLED | Kind.ACTOR_KILLED | Kind.EVALUATOR_KILLED:
                service.kill()
                time.sleep(fault.seconds)
                service.start()
            case Kind.CHECKPOINT_DAMAGED:
                service.kill()
                self._damage(random.Random(fault.seed))
                time.sleep(fault.seconds)
                service.start()
            case Kind.LEARNER_STOPPED | Kind.ACTOR_STOPPED | Kind.EVALUATOR_STOPPED:
                self._stop(service)
                time.sleep(fault.seconds)
                service.start()
            case Kind.LEARNER_PAUSED | Kind.ACTOR_PAUSED | Kind.EVALUATOR_PAUSED:
                service.pause()
                time.sleep(fault.seconds)
                service.resume()
            case Kind.FLOOD:
                self._flood(fault)
            case Kind.STRANGERS:
                self._add(strangers(self.run, fault.seconds))
            case _:
                self._disturb(self.links[fault.target], fault)

    def recovered(self, fault: Fault, since: float) -> bool:
        """Whether those that the fault hit have done their work after the moment `since`."""
        if fault.target == EVALUATOR:
            return self.observer.heard_at("evaluator", EVALUATOR) > since
        actor = None if fault.target == LEARNER else fault.target
        return self.evidence.last_acknowledgement(actor) > since

    def _disturb(self, link: Link, fault: Fault) -> None:
        if fault.kind is Kind.LINK_CUT:
            link.cut()
        elif fault.kind is Kind.LINK_SLOW:
            link.slow(random.Random(fault.seed).uniform(0.02, _SLOWEST_SECONDS))
        else:
            link.silence(
                outward=fault.kind is not Kind.LINK_SILENT_IN, inward=fault.kind is not Kind.LINK_SILENT_OUT
            )
        time.sleep(fault.seconds)
        link.heal()

    def _stop(self, service: Service) -> None:
        code = service.stop(_STOP_SECONDS)
        if code is None:
            self._fail(f"{service.name} did not end within {_STOP_SECONDS:.0f} s after SIGTERM")
            service.kill()
        elif code != 0 and time.monotonic() - service.began_at > _STOP_SECONDS:
            # While it still starts, Python itself may end it.
            self._fail(f"{service.name} ended with exit code {code} after SIGTERM")

    def _damage(self, chance: random.Random) -> None:
        """Spoil the newest checkpoint, if there is another one to go on from."""
        checkpoints = [path for _, path in numbered_checkpoints(self.run.run_folder / "checkpoints")]
        whole = [path for path in checkpoints if path.name not in self.damaged]
        if len(whole) < 2 or whole[-1] != checkpoints[-1]:
            return
        newest = checkpoints[-1]
        path = newest / chance.choice([AGENT, STATE, MANIFEST])
        _spoil(path, chance)
        self.damaged.append(newest.name)

    def _flood(self, fault: Fault) -> None:
        with self._lock:
            name = f"flood-{len(self.floods) + 1}"
            counts = Flood(name)
            self.floods.append(counts)
        learner = self.services[LEARNER]
        life = learner.starts
        flood(self.run, counts, fault.seed, fault.seconds)
        time.sleep(_METRICS_SECONDS)
        said = self.observer.metrics("learner", LEARNER)
        counted = sum(
            value for key, value in said.items() if re.fullmatch(rf"intake/invalid/\w+/{name}", key)
        )
        if learner.starts == life and counted < counts.refused - counts.settled_answered:
            self._fail(f"the learner counted {counted:.0f} refusals of {name}, which heard {counts.refused}")

    def _add(self, turned_away: dict[str, int]) -> None:
        with self._lock:
            for what, count in turned_away.items():
                self.turned_away[what] = self.turned_away.get(what, 0) + count

    def _fail(self, text: str) -> None:
        with self._lock:
            self.failures.append(text)


def _spoil(path: Path, chance: random.Random) -> None:
    """Change a bit, cut the end off, or remove the file."""
    content = bytearray(path.read_bytes())
    how = chance.choice(["bit", "bit", "end", "file"])
    if how == "file":
        path.unlink()
    elif how == "end":
        path.write_bytes(content[: chance.randrange(len(content))])
    else:
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        path.write_bytes(content)
