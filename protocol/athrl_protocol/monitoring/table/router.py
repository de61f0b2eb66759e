"""What a router shows at its endpoint; it reports nothing to others."""

from __future__ import annotations

from athrl_protocol.monitoring.table.metric import Group, Metric

ROUTER = (
    Group(
        "router",
        "athrl_router_",
        (
            Metric("connections", "connections", "Open connections, that to the learner included."),
            Metric(
                "services/ROLE",
                "services",
                "Services of the run that are present, by role, as the router sees them.",
            ),
            Metric(
                "learner_silent_seconds",
                "learner_silent_seconds",
                "Seconds since the learner last told the state of the run.",
            ),
        ),
    ),
)
"""What a router shows at its endpoint; it reports nothing to others."""
