"""Alerts, dashboard and configuration use metrics that are there, and are what their programs take."""

from __future__ import annotations

import itertools
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from tests.monitoring.files import (
    ALERTS,
    CONFIGURATION,
    DASHBOARD,
    FOLDER,
    ROOT,
    alerts,
    dashboard,
    dashboard_queries,
    exposed_names,
    measured_by,
    names_in,
    panels,
)

needs_promtool = pytest.mark.skipif(
    shutil.which("promtool") is None, reason="Prometheus is not installed: apt-get install prometheus"
)
DEPLOYED = [
    path
    for path in (ROOT / "deploy").rglob("*")
    if path.suffix in (".yml", ".yaml", ".json") and "athrl_" in path.read_text()
]


@pytest.mark.parametrize("path", DEPLOYED, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_metric_that_is_asked_for_exists(path: Path) -> None:
    assert names_in(path.read_text()) <= exposed_names()


def test_dashboard_and_alerts_are_among_what_is_held_to_that() -> None:
    assert {DASHBOARD, ALERTS} <= set(DEPLOYED)


def test_every_alert_says_how_grave_it_is_and_what_to_do() -> None:
    for alert in alerts():
        assert alert["labels"]["severity"] in ("warning", "critical"), alert["alert"]
        assert set(alert["annotations"]) == {"summary", "action"}, alert["alert"]


def test_parts_of_an_alert_are_compared_without_being_filtered() -> None:
    assert measured_by("a > 1\nand on (x) b[5m] <= c unless d") == ["a > bool 1", "b[5m] <= bool c", "d"]


def test_panels_lie_beside_each_other_with_a_title_and_a_description() -> None:
    places = []
    for panel in dashboard()["panels"]:
        assert panel["title"]
        at = panel["gridPos"]
        assert 0 <= at["x"] <= at["x"] + at["w"] <= 24
        places.append((at["x"], at["y"], at["x"] + at["w"], at["y"] + at["h"]))
    for one, other in itertools.combinations(places, 2):
        apart = one[2] <= other[0] or other[2] <= one[0] or one[3] <= other[1] or other[3] <= one[1]
        assert apart, (one, other)
    assert all(panel["description"] for panel in panels())
    ids = [panel["id"] for panel in dashboard()["panels"]]
    assert len(set(ids)) == len(ids)


def test_scores_that_two_endpoints_show_are_one_curve() -> None:
    """The learner's and the evaluator's; a target of its own is among the labels of each."""
    queries = [query for query in dashboard_queries("r") if "athrl_evaluation_" in query]
    assert queries
    assert [query for query in queries if not query.startswith("max by (driver, town) (")] == []


def test_prometheus_and_grafana_find_what_compose_starts() -> None:
    compose = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]
    jobs = yaml.safe_load(CONFIGURATION.read_text())["scrape_configs"]
    targets = [target for job in jobs for each in job.get("static_configs", ()) for target in each["targets"]]
    names = [name for job in jobs for each in job.get("dns_sd_configs", ()) for name in each["names"]]
    assert {*(target.partition(":")[0] for target in targets), *names} == {"learner", "evaluator", "router"}
    assert {job["job_name"] for job in jobs} == {"athrl-learner", "athrl-evaluator", "athrl-router"}
    (source,) = yaml.safe_load((FOLDER / "grafana/provisioning/datasources/prometheus.yml").read_text())[
        "datasources"
    ]
    assert source["url"] == "http://prometheus:9090"
    assert "prometheus" in compose
    (provider,) = yaml.safe_load((FOLDER / "grafana/provisioning/dashboards/athrl.yml").read_text())[
        "providers"
    ]
    mounted = [volume for volume in compose["grafana"]["volumes"] if provider["options"]["path"] in volume]
    assert mounted == [f"./{DASHBOARD.parent.relative_to(ROOT)}:{provider['options']['path']}:ro"]


@needs_promtool
@pytest.mark.parametrize(
    "arguments",
    [
        ["check", "config", "--lint=all", "prometheus.yml"],
        ["check", "rules", "alerts.yml"],
        ["test", "rules", "alerts_test.yml"],
    ],
    ids=" ".join,
)
def test_promtool_accepts(arguments: list[str]) -> None:
    result = subprocess.run(["promtool", *arguments], cwd=FOLDER, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stdout + result.stderr


@needs_promtool
def test_every_alert_is_tried() -> None:
    tried = (FOLDER / "alerts_test.yml").read_text()
    assert [alert["alert"] for alert in alerts() if alert["alert"] not in tried] == []
