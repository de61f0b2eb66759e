"""A real run as Prometheus sees it; the queries are asked of a real one where it is installed."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator

import pytest
from athrl_protocol import MetricsReport, MetricsSubscriber, open_session
from athrl_protocol.monitoring.families import Reader
from athrl_protocol.monitoring.table import ACTOR, EVALUATOR, LEARNER

from tests.monitoring.conftest import RUN, ScrapedRun
from tests.monitoring.files import alerts, dashboard_queries, exposed_names, measured_by
from tests.monitoring.prometheus import Prometheus, running_prometheus

pytestmark = [pytest.mark.slow, pytest.mark.timeout(500)]

ANSWERED_SECONDS = 120.0
GROUPS = {"learner": LEARNER, "actor": ACTOR, "evaluator": EVALUATOR}
IN_TENSORBOARD_ONLY = ("intake/invalid/", "last_")


@pytest.fixture(scope="module")
def prometheus(
    scraped_run: ScrapedRun, tmp_path_factory: pytest.TempPathFactory, free_port: Callable[[], int]
) -> Iterator[Prometheus]:
    if shutil.which("prometheus") is None:
        pytest.skip("Prometheus is not installed: apt-get install prometheus")
    folder = tmp_path_factory.mktemp("prometheus")
    with running_prometheus(folder, free_port(), scraped_run.ports) as prometheus:
        yield prometheus


def test_services_report_what_the_table_has_and_nothing_else(
    scraped_run: ScrapedRun, eventually: Callable[[Callable[[], bool], float], None]
) -> None:
    seen: dict[str, set[str]] = {role: set() for role in GROUPS}
    wanted = {
        role: {metric.name for group in groups for metric in group.metrics if not metric.labels}
        for role, groups in GROUPS.items()
    }

    def take(report: MetricsReport) -> None:
        seen[report.role] |= set(report.values)

    with (
        open_session(connect=scraped_run.address, timeout=30) as session,
        MetricsSubscriber(session, RUN, take),
    ):
        eventually(lambda: all(wanted[role] <= seen[role] for role in GROUPS), ANSWERED_SECONDS)
    for role, groups in GROUPS.items():
        known = {place.metric.name for place in Reader(groups).read(dict.fromkeys(seen[role], 1.0))}
        assert wanted[role] <= known
        unknown = [name for name in seen[role] if not Reader(groups).read({name: 1.0})]
        assert [name for name in unknown if not name.startswith(IN_TENSORBOARD_ONLY)] == []


def test_prometheus_scrapes_every_service(
    prometheus: Prometheus, eventually: Callable[[Callable[[], bool], float], None]
) -> None:
    jobs = {"athrl-learner": "up", "athrl-evaluator": "up", "athrl-router": "up"}
    eventually(lambda: prometheus.ready() and prometheus.targets() == jobs, ANSWERED_SECONDS)
    assert prometheus.values('athrl_router_services{role="actor"}') == [1.0]
    assert prometheus.values("athrl_actors_reporting") == [1.0]
    assert prometheus.ask("label/run/values") == [RUN]


def test_actors_behind_a_router_are_counted_at_the_learner(
    prometheus: Prometheus, eventually: Callable[[Callable[[], bool], float], None]
) -> None:
    eventually(lambda: min(prometheus.values("rate(athrl_actors_decisions_total[30s])"), default=0) > 0, 60)
    assert prometheus.values('athrl_actor_decisions_total{actor="actor-1"}')[0] > 0


@pytest.mark.parametrize("query", list(dashboard_queries(RUN)))
def test_query_of_the_dashboard_is_answered(
    prometheus: Prometheus, query: str, eventually: Callable[[Callable[[], bool], float], None]
) -> None:
    eventually(lambda: bool(prometheus.values(query)), ANSWERED_SECONDS)


@pytest.mark.parametrize("alert", alerts(), ids=lambda alert: alert["alert"])
def test_condition_of_the_alert_is_measured(
    prometheus: Prometheus, alert: dict, eventually: Callable[[Callable[[], bool], float], None]
) -> None:
    for part in measured_by(alert["expr"]):
        eventually(lambda part=part: bool(prometheus.values(part)), ANSWERED_SECONDS)


def test_alerts_are_loaded_and_evaluated_and_none_is_critical(
    prometheus: Prometheus, eventually: Callable[[Callable[[], bool], float], None]
) -> None:
    def rules() -> list[dict]:
        return [rule for group in prometheus.ask("rules")["groups"] for rule in group["rules"]]

    eventually(lambda: all(rule["health"] == "ok" for rule in rules()), ANSWERED_SECONDS)
    assert [rule["name"] for rule in rules()] == [alert["alert"] for alert in alerts()]
    critical = [rule for rule in rules() if rule["labels"]["severity"] == "critical"]
    assert [rule["name"] for rule in critical if rule["state"] == "firing"] == []


def test_endpoint_shows_names_of_the_table_only(scraped_run: ScrapedRun) -> None:
    for job in scraped_run.ports:
        ours = {name for name in scraped_run.names(job) if name.startswith("athrl_")}
        assert ours
        assert ours <= exposed_names()
