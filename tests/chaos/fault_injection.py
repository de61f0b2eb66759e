"""Fault injection: starts the run, injects the faults, ends the run gracefully."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field

from tests.chaos.disk import Disk
from tests.chaos.evidence import Evidence
from tests.chaos.faults import Faults, within
from tests.chaos.link_proxy import LinkProxies
from tests.chaos.observer import Observer
from tests.chaos.outages import Outage
from tests.chaos.processes import Ending, Service, Supervisor
from tests.chaos.run import EVALUATOR, LEARNER, ROUTER, ChaosRun
from tests.chaos.schedule import FAMILIES, Group, Kind, complete, schedule

START_SECONDS = 240.0
"""Limit until all services work; a busy machine compiles slowly."""
RECOVERY_SECONDS = 120.0
"""Limit until all services work again; far more than needed, since the machine may be busy."""
END_SECONDS = 120.0
SHORT_PAUSE, LONG_PAUSE = 9.0, 30.0


@dataclass
class Observed:
    """What is known after all processes have ended.

    Attributes:
        outages: the faults as they happened.
        faults: floods, damaged checkpoints and failures.
        evidence: records of the actors.
        endings: exits of services that were not requested.
        working: times at which all services worked first, and at which the end was requested.
        updates: updates of the learner at these two times.
        not_finite: metrics that were not finite.
        failures: what went wrong, one line each.
    """

    outages: list[Outage]
    faults: Faults
    evidence: Evidence
    endings: list[Ending]
    working: tuple[float, float]
    updates: tuple[float, float]
    not_finite: set[str] = field(default_factory=set)
    failures: list[str] = field(default_factory=list)


def inject_faults(
    run: ChaosRun, disk: Disk, seed: int, seconds: float, say: Callable[[str], None]
) -> Observed:
    """Run with faults for so many seconds after all services work; afterwards no process is left.

    It takes longer until the required faults have occurred: one of each family, in a long run every kind.
    """
    with ExitStack() as stack:
        proxies = stack.enter_context(LinkProxies(run.next_ports))
        services = {service.name: service for service in run.services(proxies.links)}
        for service in services.values():
            service.start()
        stack.enter_context(Supervisor(list(services.values())))
        observer = stack.enter_context(Observer(run, START_SECONDS))
        evidence = Evidence(run.evidence)
        faults = Faults(run, disk, services, proxies.links, observer, evidence)
        _await_all_services(run, faults)
        began, updates = time.monotonic(), observer.metrics("learner", LEARNER).get("updates", 0.0)
        say("all services work; the faults begin")
        longest = LONG_PAUSE if run.long else SHORT_PAUSE
        kinds = possible_kinds(disk)
        happened: set[Kind] = set()
        outages = []
        for group in schedule(seed, run.targets, kinds, longest_pause=longest):
            if time.monotonic() - began >= seconds and complete(happened, kinds, every=run.long):
                break
            happened.update(fault.kind for fault in group.faults)
            outages.append(_inject(group, faults, say))
        _recover(outages[-1:], faults)
        ended = time.monotonic()
        say("no more faults; ending the run")
        failures = [*faults.failures, *_end(services)]
        observer.archive()
        evidence.read()
        last = observer.metrics("learner", LEARNER).get("updates", 0.0)
    endings = [ending for service in services.values() for ending in service.endings]
    return Observed(
        outages,
        faults,
        evidence,
        endings,
        (began, ended),
        (updates, last),
        set(observer.not_finite),
        failures,
    )


def possible_kinds(disk: Disk) -> frozenset[Kind]:
    """Return the possible faults: a disk that could not be mounted does not get full."""
    return frozenset(Kind) - frozenset(() if disk.permitted else FAMILIES["disk"])


def _await_all_services(run: ChaosRun, faults: Faults) -> None:
    """Wait until every actor has acknowledgements, training has begun and the evaluator reports."""

    def works() -> bool:
        return (
            all(faults.evidence.last_acknowledgement(actor) > 0 for actor in run.actors)
            and faults.observer.last_report_at("evaluator", EVALUATOR) > 0
            and faults.observer.metrics("learner", LEARNER).get("updates", 0.0) > 0
        )

    if not within(START_SECONDS, works):
        raise TimeoutError(f"the run did not work within {START_SECONDS:.0f} s: see {run.logs}")


def _inject(group: Group, faults: Faults, say: Callable[[str], None]) -> Outage:
    """Inject a group of faults at the same time, and wait for the recovery if the group says so."""
    for fault in group.faults:
        say(f"{fault.kind}: {fault.target}, {fault.seconds:.1f} s")
    began = time.monotonic()
    with ThreadPoolExecutor(len(group.faults)) as pool:
        list(pool.map(faults.happen, group.faults))
    outage = Outage(group, began, time.monotonic())
    if group.recovers_first:
        _recover([outage], faults)
        if outage.recovered is not None:
            say(f"recovered after {outage.recovered - outage.ended:.1f} s")
            time.sleep(group.calm)
    return outage


def _recover(outages: list[Outage], faults: Faults) -> None:
    """Wait for the recovery from outages that have not recovered yet."""
    for outage in outages:
        if outage.recovered is not None:
            continue
        hit = outage.group.faults

        def all_work(hit: tuple = hit, since: float = outage.ended) -> bool:
            return all(faults.recovered(fault, since) for fault in hit)

        if within(RECOVERY_SECONDS, all_work):
            outage.recovered = time.monotonic()
        else:
            what = " and ".join(f"{fault.kind} ({fault.target})" for fault in hit)
            faults.failures.append(f"no recovery within {RECOVERY_SECONDS:.0f} s from: {what}")


def _end(services: dict[str, Service]) -> list[str]:
    """End the actors, which send what they hold, then all others; return failures."""
    learner, evaluator, router = services[LEARNER], services[EVALUATOR], services[ROUTER]
    actors = [service for service in services.values() if service not in (learner, evaluator, router)]
    failures = []
    for together in (actors, [evaluator], [router], [learner]):
        with ThreadPoolExecutor(len(together)) as pool:
            codes = list(pool.map(lambda service: service.stop(END_SECONDS), together))
        for service, code in zip(together, codes, strict=True):
            if code != 0:
                failures.append(f"{service.name} ended with {code} instead of 0: {service.last_line()}")
    return failures
