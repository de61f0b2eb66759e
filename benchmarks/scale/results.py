"""The measurements as files of benchmarks/results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.scale.driving import Driven
from benchmarks.scale.flood import Flooded
from benchmarks.scale.plan import BEHIND_A_ROUTER, PUBLISH_SECONDS, Need, Row

_SECTION = "Experience on its way"
_PAGE = "how-to/run-on-a-cluster.md"


def measured_table(
    flooded: Sequence[Flooded], driven: Driven, delay: float, loss: float, load: float
) -> dict[str, Any]:
    """What sixteen actors in racks cost, on each way."""
    rows: list[Row] = [
        [
            f"only send, {each.way}",
            round(each.per_second),
            round(1000 * each.learner_cpu, 1),
            round(1000 * each.router_cpu, 1) or None,
            round(each.bytes_a_decision),
        ]
        for each in flooded
    ]
    rows.append(
        [
            f"{driven.actors} that drive, directly",
            round(driven.per_second),
            round(1000 * driven.learner_cpu, 1),
            None,
            round(driven.bytes_a_decision),
        ]
    )
    return {
        "subject": "scale",
        "section": _SECTION,
        "title": "Actors in other racks",
        "question": f"What do {driven.actors} actors cost, {delay:g} ms away, {loss:.1%} of packets lost?",
        "machine": f"load {load:.0f}: rates are a lower bound, costs are seconds of a core",
        "page": _PAGE,
        "columns": [
            "actors",
            "decisions/s",
            "learner, ms of a core for 1,000",
            "router, ms for 1,000",
            "bytes a decision",
        ],
        "rows": rows,
        "notes": [
            "Everything that was acknowledged was stored, on each way.",
            "Actors that only send have made-up pictures, which compress worse than a town's.",
            f"Policies: {driven.policy_bytes / 1e6:.1f} MB to each connection every {PUBLISH_SECONDS:g} s.",
        ],
    }


def plan_table(bounds: Sequence[Row], needs: Mapping[int, Need], per_actor: float) -> dict[str, Any]:
    """What one of each bears, and what more actors than were measured would need."""
    rows: list[Row] = [[what, bears if bears is None else f"{bears:,}", why] for what, bears, why in bounds]
    for actors, each in needs.items():
        need = f"intake {each.learner_cores:.1f} cores; line in {each.line_in:.0%}, out {each.line_out:.0%}"
        rows.append([f"{actors:,} actors, extrapolated", f"{each.decisions:,.0f}", need])
    more = {actors: each for actors, each in needs.items() if actors != min(needs)}
    routed = " and ".join(f"{each.line_out_routed:.0%} by {actors:,}" for actors, each in more.items())
    return {
        "subject": "scale-plan",
        "section": _SECTION,
        "title": "What one of each bears",
        "question": "How many decisions a second do one learner, one router and one line bear?",
        "page": _PAGE,
        "columns": ["what", "decisions/s", "because of"],
        "rows": rows,
        "notes": [
            "Measured on busy cores, where costs rise: what a core bears here is a lower bound.",
            f"Extrapolated in proportion, {per_actor:g} decisions/s of each actor. Training is not counted.",
            *(
                f"What breaks first with {actors:,}: {each.breaks or 'nothing'}."
                for actors, each in more.items()
            ),
            f"With a router for {BEHIND_A_ROUTER} actors each, the line out is filled to {routed}.",
        ],
    }
