"""Holds a storm to account, and says what it came to: tables for people, one object for machines."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import Any

from athrl.errors import EXPECTED_ERROR
from rich.console import Console
from rich.table import Table

from tests.chaos.learning import evaluate, improved
from tests.chaos.outages import longest_stall, recovery_table
from tests.chaos.reckoning import Account, Log, compare, imbalances, read_log
from tests.chaos.restored import replay_differences
from tests.chaos.run import LEARNER, StormyRun
from tests.chaos.schedule import FAMILIES, Kind
from tests.chaos.storm import Observed, possible_kinds

STALL_SECONDS = 60.0
"""Nothing may stand still for so long while all is well, however busy the machine is."""
_MOST_LINES = 10


def reckon(run: StormyRun, seen: Observed) -> dict[str, Any]:
    """Return everything that a storm came to; `failures` is empty if every account balances."""
    log = read_log(run.archive)
    account = compare(seen.evidence, log)
    moments = [moment for of in seen.evidence.acknowledged_at.values() for moment in of]
    stall = longest_stall(moments, seen.outages, *seen.working)
    learned = _learned(run) if run.long else None
    failures = [
        *seen.failures,
        *_failures(run, seen, log, account),
        *(
            [f"nothing was acknowledged for {stall:.0f} s while all was well"]
            if stall > STALL_SECONDS
            else []
        ),
        *([f"the policy did not improve: {learned}"] if learned and not learned["improved"] else []),
    ]
    floods = seen.faults.floods
    kinds = [fault.kind for outage in seen.outages for fault in outage.group.faults]
    return {
        "faults": len(kinds),
        "faults_by_kind": dict(sorted(Counter(kinds).items())),
        "kills": sum(fault.value.count("killed") for fault in kinds),
        "left_out": sorted(set(Kind) - possible_kinds(seen.faults.disk)),
        **asdict(account),
        "intake_paused": seen.faults.paused,
        "longest_stall_s": round(stall, 2),
        "recovery": recovery_table(seen.outages),
        "malformed_sent": sum(flood.sent for flood in floods),
        "malformed_refused": sum(flood.refused for flood in floods),
        "malformed_unanswered": sum(flood.unanswered for flood in floods),
        "known_repeated": sum(flood.repeated for flood in floods),
        "strangers_turned_away": seen.faults.turned_away,
        "checkpoints_damaged": len(seen.faults.damaged),
        "ended_by_themselves": [ending._asdict() for ending in seen.endings],
        "updates": [int(count) for count in seen.updates],
        "learning": learned,
        "failures": failures,
    }


def draw(report: dict[str, Any], console: Console) -> None:
    """Print the recovery times and what is wrong."""
    table = Table(title="recovery, seconds from the fault's end to the next work of those it hit")
    for heading in ("fault", "count", "median", "worst"):
        table.add_column(heading, justify="left" if heading == "fault" else "right")
    for kind, times in report["recovery"].items():
        table.add_row(kind, str(times["count"]), f"{times['median_s']:.1f}", f"{times['worst_s']:.1f}")
    console.print(table)
    for failure in report["failures"]:
        console.print(f"FAILED: {failure}", markup=False, highlight=False)


def _failures(run: StormyRun, seen: Observed, log: Log, account: Account) -> list[str]:
    before, after = seen.updates
    crashed = [ending for ending in seen.endings if ending.code not in (0, EXPECTED_ERROR)]
    found = [
        *log.problems[:_MOST_LINES],
        *imbalances(seen.evidence, log, run.run_folder / "checkpoints", seen.faults.floods),
        *replay_differences(run.run_folder, run.settings(), log),
        *_unnamed(run, seen),
        *(f"{ending.service} crashed: {ending.last_line}" for ending in crashed),
        *(f"no number: {metric}" for metric in sorted(seen.not_finite)[:_MOST_LINES]),
    ]
    for what in ("lost", "twice", "foreign"):
        if count := getattr(account, what):
            found.append(f"{count} chunks {what}")
    full = [outage for outage in seen.outages if any(f.kind in FAMILIES["disk"] for f in outage.group.faults)]
    if full and not seen.faults.paused:
        found.append("the disk was full, and the learner never said that intake pauses")
    if after <= before:
        found.append(f"training stood still: {before:.0f} updates before, {after:.0f} after")
    return found


def _unnamed(run: StormyRun, seen: Observed) -> list[str]:
    """Damaged checkpoints that no learner has named."""
    said = (run.logs / f"{LEARNER}.log").read_text(errors="replace").splitlines()
    named = [line for line in said if "using the one before" in line]
    return [
        f"{name} was damaged, and no learner said so"
        for name in seen.faults.damaged
        if not any(name in line for line in named)
    ]


def _learned(run: StormyRun) -> dict[str, Any]:
    first = evaluate(run, run.folder / "first.onnx")
    last = evaluate(run, run.run_folder / "policies" / "latest.onnx")
    return {"first": first._asdict(), "last": last._asdict(), "improved": improved(first, last)}
