"""What lies in deploy/monitoring, as data, and the names that it may use."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from athrl_protocol.monitoring.fleet import OF_ALL
from athrl_protocol.monitoring.table import ACTOR, EVALUATOR, GROUPS, LEARNER, REPORTED_AT, REPORTING, ROUTER

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "deploy" / "monitoring"
DASHBOARD = FOLDER / "grafana" / "dashboards" / "athrl-run.json"
ALERTS = FOLDER / "alerts.yml"
CONFIGURATION = FOLDER / "prometheus.yml"

_NAME = re.compile(r"\bathrl_[a-z0-9_]+\b")
_BETWEEN_SETS = re.compile(r"\s+(?:and|or|unless)(?:\s+on\s*\([^)]*\))?\s+")
_COMPARISON = re.compile(r"(==|>=|<=|>|<)(?=\s)")


def exposed_names() -> set[str]:
    """Names of all metrics that an endpoint may show, as the table has them."""
    names = {group.prefix + metric.exposed for group in GROUPS for metric in group.metrics}
    names |= {OF_ALL + metric.exposed for group in ACTOR for metric in group.metrics}
    names |= {groups[0].prefix + REPORTED_AT.exposed for groups in (LEARNER, EVALUATOR, ROUTER)}
    return names | {OF_ALL + REPORTING.exposed}


def names_in(text: str) -> set[str]:
    """Names of our metrics in a query, or in a file of queries."""
    return set(_NAME.findall(text))


def dashboard() -> dict[str, Any]:
    return json.loads(DASHBOARD.read_text())


def panels() -> list[dict[str, Any]]:
    """The panels of the dashboard that have queries."""
    return [panel for panel in dashboard()["panels"] if panel["type"] != "row"]


def dashboard_queries(run: str) -> Iterator[str]:
    """The queries of all panels, as Grafana sends them for a run."""
    for panel in panels():
        for target in panel["targets"]:
            yield target["expr"].replace("$run", run).replace("$__rate_interval", "1m")


def alerts() -> list[dict[str, Any]]:
    (group,) = yaml.safe_load(ALERTS.read_text())["groups"]
    return group["rules"]


def measured_by(alert: str) -> list[str]:
    """The parts of an alert's condition as queries whose value is 1 where the part holds, else 0."""
    return [_COMPARISON.sub(r"\1 bool", part) for part in _BETWEEN_SETS.split(" ".join(alert.split()))]
