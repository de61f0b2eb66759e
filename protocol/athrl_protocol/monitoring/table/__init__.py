"""The table of all metrics: what a service calls it, what Prometheus calls it, and what it means.

A name in capitals stands for a part that varies, such as an actor's name; in Prometheus it is a label:
`policy_lag/ACTOR` is `athrl_learner_actor_policy_lag_versions{actor="..."}`. What ends with `_total` is a
counter, everything else a gauge. Units are Prometheus': seconds, bytes, metres,
ratios of 0 to 1.
"""

from __future__ import annotations

from athrl_protocol.monitoring.table.actor import ACTOR, REPORTING
from athrl_protocol.monitoring.table.evaluator import EVALUATOR, SCORES
from athrl_protocol.monitoring.table.learner import LEARNER
from athrl_protocol.monitoring.table.metric import Group, Metric
from athrl_protocol.monitoring.table.router import ROUTER

GROUPS = (*LEARNER, *ACTOR, *EVALUATOR, *SCORES, *ROUTER)
"""Every group, in the order of the reference page."""

REPORTED_AT = Metric("", "report_timestamp_seconds", "When the service last reported, unix seconds.")
"""Of every service: its endpoint also answers while the service itself is stuck."""

__all__ = [
    "ACTOR",
    "EVALUATOR",
    "GROUPS",
    "LEARNER",
    "REPORTED_AT",
    "REPORTING",
    "ROUTER",
    "SCORES",
    "Group",
    "Metric",
]
