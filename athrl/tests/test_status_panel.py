"""The picture of a run shows what is known, and says so where nothing is."""

import io
import json
import math
from dataclasses import replace

from athrl.run_view import RunSnapshot
from athrl.status import facts
from athrl.status_panel import draw, plain_line
from athrl_protocol import EvaluationResult, Phase, RunState
from athrl_protocol.run_file import RunFile
from rich.console import Console

STATE = RunState(Phase.TRAINING, 1_500, 6_000, 320, 7, "the learner waits for the actors")
SCORES = {"return_mean": 812.0, "return_ci95": 90.5, "speed_mps": 5.1, "collision_rate": 0.25}
SNAPSHOT = RunSnapshot(
    settings=RunFile(),
    state=STATE,
    metrics={
        ("learner", "learner"): {"replay_transitions": 1490.0, "policy_lag": 2.0, "policy_lag/one": 2.0},
        ("actor", "one"): {
            "decisions_per_second": 45.0,
            "return_mean": -12.5,
            "collision_rate": 0.5,
            "speed": 4.0,
        },
    },
    evaluations={"policy": EvaluationResult("policy", 6, 1_400, "town03", 1, SCORES)},
    present=frozenset({("learner", "learner"), ("actor", "one"), ("evaluator", "evaluator")}),
    steps_per_second=45.0,
)
EMPTY = RunSnapshot(RunFile(), None, {}, {}, frozenset())


def drawn(snapshot: RunSnapshot) -> str:
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(draw(snapshot, ["look here"]))
    return console.export_text()


def test_picture_shows_progress_services_and_scores() -> None:
    text = drawn(SNAPSHOT)
    for part in (
        "1,500 of 6,000",
        "ETA 1:40",
        "320 updates",
        "1,490 of",
        "lag 2",
        "the learner waits",
        "look here",
    ):
        assert part in text
    for part in ("actor one", "45 decisions/s", "return -12.5", "4 m/s", "50 %", "812 ± 90.5", "25 %"):
        assert part in text


def test_picture_shows_routers_and_a_learner_that_is_not_heard() -> None:
    present = SNAPSHOT.present | {("router", "rig-b"), ("router", "rig-a")}
    text = drawn(replace(SNAPSHOT, present=present, silence="the learner is paused or very busy"))
    assert "routers" in text
    assert "rig-a, rig-b" in text
    assert "the learner is paused or very busy" in text
    assert "the learner waits" not in text
    assert "router" not in drawn(SNAPSHOT)
    line = plain_line(replace(SNAPSHOT, silence="the learner is paused or very busy"))
    assert line.endswith("  the learner is paused or very busy")
    values = facts(replace(SNAPSHOT, present=present, silence="it is paused"))
    assert (values["routers"], values["silence"]) == (["rig-a", "rig-b"], "it is paused")


def test_warm_up_gives_no_time_of_the_end_which_comes_many_times_later_than_it_suggests() -> None:
    warming_up = replace(SNAPSHOT, state=replace(STATE, phase=Phase.WARMING_UP))
    for text in (drawn(warming_up), plain_line(warming_up)):
        assert "ETA - " in text


def test_plain_line_says_the_same_in_one_line() -> None:
    line = plain_line(SNAPSHOT)
    assert "\n" not in line
    for part in (
        "1500/6000",
        "updates 320",
        "lag 2",
        "actors 1",
        "return -12.5",
        "4 m/s",
        "50 %",
        "812 ± 90.5",
    ):
        assert part in line


def test_run_of_which_nothing_is_known_yet_is_shown_as_that() -> None:
    assert "waiting for the learner" in drawn(EMPTY)
    assert "waiting for the learner" in plain_line(EMPTY)
    assert facts(EMPTY)["phase"] is None


def test_facts_are_plain_values_by_service() -> None:
    values = facts(SNAPSHOT)
    assert values["phase"] == "training"
    assert values["actors"]["one"]["decisions_per_second"] == 45.0
    assert values["evaluations"]["policy"]["scores"]["return_mean"] == 812.0


def test_picture_shows_the_return_in_each_of_several_towns() -> None:
    scores = {**SCORES, "town03/return_mean": 900.0, "town02/return_mean": 724.0}
    result = EvaluationResult("policy", 6, 1_400, "2 towns", 1, scores)
    snapshot = replace(SNAPSHOT, evaluations={"policy": result})
    for text in (drawn(snapshot), plain_line(snapshot)):
        assert "812 ± 90.5 (town03 900, town02 724)" in text


def test_numbers_that_are_none_are_shown_as_unknown_and_are_no_harm_to_json() -> None:
    numbers = dict.fromkeys(SNAPSHOT.metrics["actor", "one"], math.nan)
    scores = dict.fromkeys(SCORES, math.inf)
    learner = {
        "environment_steps_per_second": math.nan,
        "updates_per_second": -math.inf,
        "intake/lost": math.nan,
    }
    odd = replace(
        SNAPSHOT,
        metrics={("learner", "learner"): learner, ("actor", "one"): numbers},
        evaluations={"policy": EvaluationResult("policy", 6, 1_400, "town03", 1, scores)},
        steps_per_second=math.nan,
    )
    assert "ETA -" in drawn(odd)
    assert "return -  speed - m/s" in plain_line(odd)
    told = json.loads(json.dumps(facts(odd), allow_nan=False))
    assert told["actors"]["one"]["return_mean"] is None
    assert told["evaluations"]["policy"]["scores"]["return_mean"] is None
    assert told["warnings"] == []


def test_brackets_in_what_services_say_are_shown_as_they_are() -> None:
    changes = ("run.folder was /old [/x] [bold] and is /new, from step 7",)
    state = replace(STATE, waiting="the disk of /data/[a] is full [/b]")
    text = drawn(replace(SNAPSHOT, changes=changes, state=state))
    assert changes[0] in text
    assert state.waiting in text


def test_picture_shows_what_was_changed_in_the_settings() -> None:
    changes = tuple(f"learner.batch was {number} and is {number + 1}, from step 7" for number in range(7))
    text = drawn(replace(SNAPSHOT, changes=changes))
    assert "changed" in text
    assert all((change in text) == (number >= 2) for number, change in enumerate(changes))
    assert facts(replace(SNAPSHOT, changes=changes))["changes"] == list(changes)
    assert "changed" not in drawn(SNAPSHOT)


def test_what_should_not_happen_is_shown_with_its_count() -> None:
    counted = {"intake/lost": 1919.0, "rivals/answerers": 1.0, "unpublished_policy": 0.0}
    metrics = SNAPSHOT.metrics | {("learner", "learner"): counted}
    troubled = replace(SNAPSHOT, metrics=metrics)
    told = ("chunks lost: 1,919", "keys answered by others: 1")
    assert facts(troubled)["warnings"] == list(told)
    assert all(text in drawn(troubled) and text in plain_line(troubled) for text in told)
    assert "unpublished" not in drawn(troubled)
    assert facts(SNAPSHOT)["warnings"] == []
    assert "warnings" not in drawn(SNAPSHOT)
