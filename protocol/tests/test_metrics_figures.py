"""What an endpoint shows of the values that services report."""

import re
from collections.abc import Iterable
from pathlib import Path

import pytest
from athrl_protocol import EvaluationResult, MetricsReport
from athrl_protocol.monitoring import families, fleet
from athrl_protocol.monitoring.figures import ScoreFigures, ServiceFigures
from athrl_protocol.monitoring.fleet import ActorFigures
from athrl_protocol.monitoring.reference import with_tables
from athrl_protocol.monitoring.table import GROUPS, LEARNER, Group, Metric
from prometheus_client.registry import Collector

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "metrics.md"
RUN = {"run": "town03"}
NAMES = [(group, metric) for group in GROUPS for metric in group.metrics]


def shown(collector: Collector) -> dict[tuple[str, frozenset], float]:
    """The samples that a collector shows, by name and labels without the run's."""
    samples = [sample for family in collector.collect() for sample in family.samples]
    assert all(sample.labels["run"] == "town03" for sample in samples)
    by_place = {
        (sample.name, frozenset((key, value) for key, value in sample.labels.items() if key != "run")): (
            sample.value
        )
        for sample in samples
    }
    assert len(by_place) == len(samples), "a series is shown twice"
    return by_place


def names(collector: Collector) -> set[str]:
    return {name for name, _ in shown(collector)}


def place(name: str, **labels: str) -> tuple[str, frozenset]:
    return name, frozenset(labels.items())


def reports(actors: ActorFigures, names: Iterable[str], **values: float) -> None:
    for name in names:
        actors.take(MetricsReport("actor", name, 0.0, values))


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_every_name_of_the_table_is_prometheus_own_form_and_there_once() -> None:
    exposed = [group.prefix + metric.exposed for group, metric in NAMES]
    assert len(set(exposed)) == len(exposed)
    assert all(re.fullmatch(r"athrl_[a-z]+_[a-z0-9_]*[a-z0-9]", name) for name in exposed)
    assert all(metric.meaning.endswith(".") for _, metric in NAMES)


@pytest.mark.parametrize(("group", "metric"), NAMES, ids=[f"{g.key} {m.name}" for g, m in NAMES])
def test_unit_of_the_name_is_that_of_the_exposed_one(group: Group, metric: Metric) -> None:
    for ending, unit in (
        ("_seconds", "_seconds"),
        ("bytes", "_bytes"),
        ("_rate", "_ratio"),
        ("_mps", "_metres"),
    ):
        if metric.name.partition("/")[0].endswith(ending):
            assert unit in metric.exposed


def test_reference_page_has_a_line_for_each_metric() -> None:
    lines = PAGE.read_text().splitlines()
    for group, metric in NAMES:
        begin = f"| `{metric.name}` | `{group.prefix}{metric.exposed}"
        assert [line for line in lines if line.startswith(begin) and line.endswith(f" | {metric.meaning} |")]


def test_reference_page_without_a_group_is_an_error() -> None:
    page = PAGE.read_text()
    with pytest.raises(ValueError, match="should have"):
        with_tables(page.replace("<!-- table: router -->", ""))


def test_service_shows_its_newest_values_with_labels_for_what_varies() -> None:
    figures = ServiceFigures(LEARNER, RUN)
    assert shown(figures) == {}
    figures.show({"updates": 1.0})
    figures.show({"updates": 2.0, "policy_lag/rig-1": 3.0, "loss/intention/td_error": 0.5, "made/up": 1.0})
    values = shown(figures)
    assert values.pop(place("athrl_learner_report_timestamp_seconds")) > 1e9
    assert values == {
        place("athrl_learner_updates_total"): 2.0,
        place("athrl_learner_actor_policy_lag_versions", actor="rig-1"): 3.0,
        place("athrl_learner_td_error", level="intention"): 0.5,
    }


def test_values_that_are_not_finite_are_left_out() -> None:
    figures = ServiceFigures(LEARNER, RUN)
    figures.show({"updates": float("nan"), "log/bytes": float("inf"), "actors": 1.0})
    assert names(figures) == {"athrl_learner_actors", "athrl_learner_report_timestamp_seconds"}


def test_metric_with_too_many_series_is_left_out_and_the_others_stay() -> None:
    figures = ServiceFigures(LEARNER, RUN)
    many = {f"policy_lag/actor-{number}": 1.0 for number in range(families.MOST_SERIES + 1)}
    figures.show({**many, "policy_lag": 1.0})
    assert names(figures) == {"athrl_learner_policy_lag_versions", "athrl_learner_report_timestamp_seconds"}


def test_scores_are_those_of_each_driver_over_all_towns_and_in_each() -> None:
    scores = ScoreFigures(RUN)
    for steps, mean in ((1, 10.0), (2, 20.0)):
        values = {"return_mean": mean, "town03/return_mean": 30.0}
        scores.take(EvaluationResult("policy", steps, steps, "2 towns", 1, values))
    scores.take(EvaluationResult("random", 0, 2, "town03", 1, {"return_mean": -5.0}))
    assert shown(scores) == {
        place("athrl_evaluation_return_mean", driver="policy", town=""): 20.0,
        place("athrl_evaluation_return_mean", driver="policy", town="town03"): 30.0,
        place("athrl_evaluation_return_mean", driver="random", town=""): -5.0,
    }


def test_drivers_and_towns_that_somebody_makes_up_are_bounded() -> None:
    scores = ScoreFigures(RUN)
    for driver in range(1_000):
        towns = {f"town-{number}/return_mean": 1.0 for number in range(100)}
        scores.take(EvaluationResult(f"driver-{driver}", 0, 0, "town03", 1, towns))
    assert len(shown(scores)) <= families.MOST_SERIES**2


def test_few_actors_are_shown_by_name_and_together() -> None:
    actors = ActorFigures(RUN)
    reports(actors, ["a"], speed=2.0, decisions=10.0)
    reports(actors, ["b"], speed=4.0, decisions=5.0)
    assert shown(actors) == {
        place("athrl_actors_reporting"): 2.0,
        place("athrl_actors_decisions_total"): 15.0,
        place("athrl_actors_speed_metres_per_second", statistic="min"): 2.0,
        place("athrl_actors_speed_metres_per_second", statistic="mean"): 3.0,
        place("athrl_actors_speed_metres_per_second", statistic="max"): 4.0,
        place("athrl_actor_decisions_total", actor="a"): 10.0,
        place("athrl_actor_decisions_total", actor="b"): 5.0,
        place("athrl_actor_speed_metres_per_second", actor="a"): 2.0,
        place("athrl_actor_speed_metres_per_second", actor="b"): 4.0,
    }


def test_a_thousand_actors_are_as_many_series_as_two() -> None:
    few, many = ActorFigures(RUN), ActorFigures(RUN)
    values = {"speed": 2.0, "decisions": 10.0, "return_mean/town03": 1.0, "chunks_given_up/closed": 1.0}
    reports(few, ["a", "b"], **values)
    reports(many, (f"actor-{number}" for number in range(1_000)), **values)
    together = {name for name in shown(few) if name[0].startswith("athrl_actors_")}
    assert set(shown(many)) == together
    assert shown(many)[place("athrl_actors_decisions_total")] == 10_000


def test_counts_never_fall_when_actors_leave_come_back_or_start_again() -> None:
    clock = Clock()
    actors = ActorFigures(RUN, clock)
    total = place("athrl_actors_decisions_total")
    reports(actors, ["a"], decisions=100.0)
    reports(actors, ["b"], decisions=50.0)
    clock.now += 2 * fleet.SILENT_SECONDS
    assert shown(actors) == {place("athrl_actors_reporting"): 0.0, total: 150.0}
    reports(actors, ["a"], decisions=110.0)  # it was cut off, and goes on
    assert shown(actors)[total] == 160.0
    reports(actors, ["b"], decisions=7.0)  # another process has taken its name
    assert shown(actors)[total] == 167.0


def test_names_that_actors_make_up_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet, "REMEMBERED", 100)
    actors = ActorFigures(RUN)
    for number in range(1_000):
        reports(
            actors, [f"actor-{number}"], **{f"return_mean/{number}": 1.0, f"chunks_given_up/{number}": 1.0}
        )
    assert len(actors._actors) == 100
    assert len(actors._sums) <= fleet.MOST_SUMS
    assert set(shown(actors)) == {place("athrl_actors_reporting")}
