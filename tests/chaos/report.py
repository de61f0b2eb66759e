"""Audits a run with faults and reports the result: tables for people, one object for machines."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import Any

from athrl.errors import EXPECTED_ERROR
from rich.console import Console
from rich.table import Table

from tests.chaos.audit import Account, Log, compare, imbalances, read_log
from tests.chaos.fault_injection import Observed, possible_kinds
from tests.chaos.learning import evaluate, improved
from tests.chaos.outages import longest_stall, recovery_table
from tests.chaos.replay_check import replay_differences
from tests.chaos.run import LEARNER, ChaosRun
from tests.chaos.schedule import FAMILIES, Kind

STALL_SECONDS = 60.0
"""Limit without acknowledgements while there is no fault, even on a busy machine."""
_MOST_LINES = 10


def summarise(run: ChaosRun, seen: Observed) -> dict[str, Any]:
    """Return all results; `failures` is empty if everything agrees."""
    log = read_log(run.archive)
    account = compare(seen.evidence, log)
    moments = [moment for of in seen.evidence.acknowledged_at.values() for moment in of]
    stall = longest_stall(moments, seen.outages, *seen.working)
    learned = _learned(run) if run.long else None
    failures = [
        *seen.failures,
        *_failures(run, seen, log, account),
        *([f"nothing was acknowledged for {stall:.0f} s without a fault"] if stall > STALL_SECONDS else []),
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
        "forged_sent": sum(forgery.sent for forgery in seen.faults.forgeries),
        "forged_taken_in": sum(forgery.taken_in for forgery in seen.faults.forgeries),
        "forged_refused": sum(forgery.refused for forgery in seen.faults.forgeries),
        "checkpoints_damaged": len(seen.faults.damaged),
        "ended_by_themselves": [ending._asdict() for ending in seen.endings],
        "updates": [int(count) for count in seen.updates],
        "learning": learned,
        "failures": failures,
    }


def draw(report: dict[str, Any], console: Console) -> None:
    """Print recovery times and failures."""
    table = Table(title="recovery, seconds from the end of a fault until its targets work again")
    for heading in ("fault", "count", "median", "worst"):
        table.add_column(heading, justify="left" if heading == "fault" else "right")
    for kind, times in report["recovery"].items():
        table.add_row(kind, str(times["count"]), f"{times['median_s']:.1f}", f"{times['worst_s']:.1f}")
    console.print(table)
    for failure in report["failures"]:
        console.print(f"FAILED: {failure}", markup=False, highlight=False)


def _failures(run: ChaosRun, seen: Observed, log: Log, account: Account) -> list[str]:
    before, after = seen.updates
    crashed = [ending for ending in seen.endings if ending.code not in (0, EXPECTED_ERROR)]
    found = [
        *log.problems[:_MOST_LINES],
        *imbalances(seen.evidence, log, run.run_folder / "checkpoints", seen.faults.floods),
        *replay_differences(run.run_folder, run.settings(), log),
        *_unreported_damage(run, seen),
        *(f"{ending.service} crashed: {ending.last_line}" for ending in crashed),
        *(f"not finite: {metric}" for metric in sorted(seen.not_finite)[:_MOST_LINES]),
    ]
    for what in ("lost", "twice", "foreign"):
        if count := getattr(account, what):
            found.append(f"{count} chunks {what}")
    full = [outage for outage in seen.outages if any(f.kind in FAMILIES["disk"] for f in outage.group.faults)]
    if full and not seen.faults.paused:
        found.append("the disk was full, and the learner did not report that intake pauses")
    if after <= before:
        found.append(f"training made no progress: {before:.0f} updates before, {after:.0f} after")
    return found


def _unreported_damage(run: ChaosRun, seen: Observed) -> list[str]:
    """Damaged checkpoints that the learner did not report."""
    said = (run.logs / f"{LEARNER}.log").read_text(errors="replace").splitlines()
    named = [line for line in said if "using the one before" in line]
    return [
        f"{name} was damaged, and the learner did not report it"
        for name in seen.faults.damaged
        if not any(name in line for line in named)
    ]


def _learned(run: ChaosRun) -> dict[str, Any]:
    first = evaluate(run, run.folder / "first.onnx")
    last = evaluate(run, run.run_folder / "policies" / "latest.onnx")
    return {"first": first._asdict(), "last": last._asdict(), "improved": improved(first, last)}
