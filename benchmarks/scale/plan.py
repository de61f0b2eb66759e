"""What follows from the measurements for one learner, one router, one line, and for many actors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from athrl_protocol import RunFile

from benchmarks.scale.connections import Connected
from benchmarks.scale.driving import Driven
from benchmarks.scale.flood import Flooded

LINE_BITS = 10e9
"""Of one line, each way, in a second."""
PUBLISH_SECONDS = RunFile().learner.publish_seconds
"""Between two policies, by default; the learner that was measured hardly trains, and publishes less often."""
BEHIND_A_ROUTER = 50
"""Actors that share a rack's router."""

Row = list[str | float | None]


@dataclass(frozen=True)
class Need:
    """What a number of actors needs.

    Attributes:
        decisions: a second.
        learner_cores: of intake.
        router_cores: of one router that all pass.
        line_in: share of a line to the learner that experience fills.
        line_out: share of a line from the learner that policies fill, each actor connected to it.
        line_out_routed: the same with a router for each rack.
        learner_mebibytes: for the connections.
    """

    decisions: float
    learner_cores: float
    router_cores: float
    line_in: float
    line_out: float
    line_out_routed: float
    learner_mebibytes: float

    @property
    def breaks(self) -> str:
        """What is used up first, a core or a line, without routers in the racks; empty if nothing is."""
        shares = {
            "the learner's line, by policies": self.line_out,
            "the learner's line, by experience": self.line_in,
            "the core that takes in": self.learner_cores,
        }
        worst = max(shares, key=lambda name: shares[name])
        return worst if shares[worst] > 1 else ""


def need(
    actors: int, per_actor: float, flooded: Sequence[Flooded], driven: Driven, connected: Connected
) -> Need:
    """What actors need that each make `per_actor` decisions a second; proportional to what was measured."""
    direct, routed, _ = flooded
    decisions = actors * per_actor
    to_an_actor = 8 * bytes_to_a_connection(driven)
    return Need(
        decisions=decisions,
        learner_cores=decisions * direct.learner_cpu / 1000,
        router_cores=decisions * routed.router_cpu / 1000,
        line_in=decisions * driven.bytes_a_decision * 8 / LINE_BITS,
        line_out=actors * to_an_actor / LINE_BITS,
        line_out_routed=-(-actors // BEHIND_A_ROUTER) * to_an_actor / LINE_BITS,
        learner_mebibytes=actors * connected.learner_mebibytes,
    )


def bytes_to_a_connection(driven: Driven) -> float:
    """Bytes a second to each connection of a learner that trains: it publishes every `PUBLISH_SECONDS`."""
    elapsed = driven.decisions / driven.per_second
    others = driven.bytes_to_an_actor - driven.policies * driven.policy_bytes / elapsed
    return max(0.0, others) + driven.policy_bytes / PUBLISH_SECONDS


def bounds(flooded: Sequence[Flooded], driven: Driven, connected: Connected) -> list[Row]:
    """Rows: what, decisions a second that it bears, and from which figure that follows."""
    direct, routed, layers = flooded
    return [
        ["one learner, a core for intake", _round(1000 / direct.learner_cpu), _cpu(direct.learner_cpu)],
        ["one router, a core", _round(1000 / routed.router_cpu), _cpu(routed.router_cpu)],
        ["the second of two routers, a core", _round(1000 / layers.router_cpu), _cpu(layers.router_cpu)],
        [
            "a line of 10 Gbit/s, experience",
            _round(LINE_BITS / 8 / driven.bytes_a_decision),
            f"{driven.bytes_a_decision:,.0f} bytes a decision",
        ],
        [
            "a line of 10 Gbit/s, policies",
            None,
            f"{LINE_BITS / 8 / bytes_to_a_connection(driven):,.0f} connections, "
            f"{bytes_to_a_connection(driven) / 1e6:.2f} MB/s to each",
        ],
        [
            "1 GiB of memory for connections",
            None,
            f"{1024 / connected.learner_mebibytes:,.0f} actors at a learner, "
            f"{1024 / connected.router_mebibytes:,.0f} at a router",
        ],
    ]


def _cpu(seconds: float) -> str:
    return f"{1000 * seconds:.1f} ms of a core for 1,000 decisions"


def _round(number: float) -> int:
    """Two digits: more would say more than is known."""
    digits = len(str(int(number))) - 2
    return int(round(number, -digits))
