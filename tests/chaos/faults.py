"""Executes faults, and checks when their targets work again."""

from __future__ import annotations

import random
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from athrl_learner.checkpoint.content import AGENT, MANIFEST, STATE, numbered_checkpoints

from tests.chaos.disk import Disk
from tests.chaos.evidence import Evidence
from tests.chaos.flood import Flood, flood, strangers
from tests.chaos.forgery import Forgery, forge
from tests.chaos.link_proxy import Link
from tests.chaos.observer import Observer
from tests.chaos.processes import Service
from tests.chaos.run import EVALUATOR, LEARNER, ROUTER, ChaosRun
from tests.chaos.schedule import Fault, Kind

_STOP_SECONDS = 90.0
_SLOWEST_SECONDS = 0.2
_METRICS_SECONDS = 2.5
_NOTICE_SECONDS = 30.0
_RETURN_SECONDS = 90.0
_PAUSES = "intake pauses, nothing is lost"


@dataclass
class Faults:
    """The targets of faults, and the results.

    Attributes:
        floods: outcomes of the messages of each flood.
        forgeries: outcomes of the chunks of each forging actor.
        turned_away: refused connections of strangers, by what they lacked.
        damaged: names of the damaged checkpoints.
        paused: how often the learner reported that intake pauses because of a full disk.
        failures: what went wrong during faults, one line each.
    """

    run: ChaosRun
    disk: Disk
    services: dict[str, Service]
    links: dict[str, Link]
    observer: Observer
    evidence: Evidence
    floods: list[Flood] = field(default_factory=list)
    forgeries: list[Forgery] = field(default_factory=list)
    turned_away: dict[str, int] = field(default_factory=dict)
    damaged: list[str] = field(default_factory=list)
    paused: int = 0
    failures: list[str] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def happen(self, fault: Fault) -> None:
        """Execute a fault; killed services are restarted."""
        service = self.services[fault.target]
        match fault.kind:
            case Kind.LEARNER_KILLED | Kind.ACTOR_KILLED | Kind.EVALUATOR_KILLED | Kind.ROUTER_KILLED:
                service.kill()
                time.sleep(fault.seconds)
                service.start()
            case Kind.CHECKPOINT_DAMAGED:
                service.kill()
                self._damage(random.Random(fault.seed))
                time.sleep(fault.seconds)
                service.start()
            case Kind.LEARNER_STOPPED | Kind.ACTOR_STOPPED | Kind.EVALUATOR_STOPPED | Kind.ROUTER_STOPPED:
                self._stop(service)
                time.sleep(fault.seconds)
                service.start()
            case Kind.LEARNER_PAUSED | Kind.ACTOR_PAUSED | Kind.EVALUATOR_PAUSED | Kind.ROUTER_PAUSED:
                service.pause()
                time.sleep(fault.seconds)
                service.resume()
            case Kind.DISK_FULL | Kind.DISK_FULL_LEARNER_KILLED:
                self._fill_disk(fault)
            case Kind.FLOOD:
                self._flood(fault)
            case Kind.STRANGERS:
                self._add(strangers(self.run, fault.seconds))
            case Kind.FORGERY:
                self._forge(fault)
            case _:
                self._disturb(self.links[fault.target], fault)

    def recovered(self, fault: Fault, since: float) -> bool:
        """Whether the targets of the fault have worked after the time `since`."""
        if fault.target == EVALUATOR:
            return self.observer.last_report_at("evaluator", EVALUATOR) > since
        hit = {LEARNER: self.run.actors, ROUTER: self.run.behind_router}.get(fault.target, (fault.target,))
        return all(self.evidence.last_acknowledgement(actor) > since for actor in hit)

    def _fill_disk(self, fault: Fault) -> None:
        """Fill the disk, or leave less than the reserve for checkpoints, until the learner reports it."""
        learner = self.services[LEARNER]
        reserve = self.run.settings().durability.reserve_mebibytes * 2**20
        told = learner.said().count(_PAUSES)
        self.disk.fill(random.Random(fault.seed).choice([0, round(reserve / 2)]))
        try:
            self.paused += within(_NOTICE_SECONDS, lambda: learner.said().count(_PAUSES) > told)
            time.sleep(fault.seconds)
            if fault.kind is Kind.DISK_FULL_LEARNER_KILLED:
                self._kill_while_full(learner)
        finally:
            self.disk.empty()

    def _kill_while_full(self, learner: Service) -> None:
        """Kill the learner; the restarted one must work although the disk is full."""
        learner.kill()
        learner.start()
        if not within(
            _RETURN_SECONDS, lambda: self.observer.last_report_at(LEARNER, LEARNER) > learner.began_at
        ):
            self._fail(f"the learner was not back within {_RETURN_SECONDS:.0f} s while its disk was full")

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
            # While it is starting, Python itself may end it.
            self._fail(f"{service.name} ended with exit code {code} after SIGTERM")

    def _damage(self, chance: random.Random) -> None:
        """Damage the newest checkpoint, if there is another one to resume from."""
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
            self._fail(f"the learner counted {counted:.0f} refusals of {name}, which got {counts.refused}")

    def _forge(self, fault: Fault) -> None:
        with self._lock:
            counts = Forgery(f"forger-{len(self.forgeries) + 1}")
            self.forgeries.append(counts)
        forge(self.run, counts, fault.seed, fault.seconds)
        if counts.admitted:
            self._fail(f"{counts.admitted} chunks of {counts.name} from the far future were taken in")

    def _add(self, turned_away: dict[str, int]) -> None:
        with self._lock:
            for what, count in turned_away.items():
                self.turned_away[what] = self.turned_away.get(what, 0) + count

    def _fail(self, text: str) -> None:
        with self._lock:
            self.failures.append(text)


def within(seconds: float, condition: Callable[[], bool]) -> bool:
    """Whether the condition became true within so many seconds."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def _spoil(path: Path, chance: random.Random) -> None:
    """Flip a bit, truncate the file, or remove it."""
    content = bytearray(path.read_bytes())
    how = chance.choice(["bit", "bit", "end", "file"])
    if how == "file":
        path.unlink()
    elif how == "end":
        path.write_bytes(content[: chance.randrange(len(content))])
    else:
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        path.write_bytes(content)
