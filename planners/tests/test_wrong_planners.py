"""What cannot be is refused in one line that says what, what it was and what it should be."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import pytest
from athrl_planners import Agent, LevelPlan, Planner, UnknownPlanner, make_agent, planner, planners, registry
from athrl_planners.settings import ActorCriticSettings, QLearningSettings
from athrl_spaces import DIRECT, WAYPOINT, WAYPOINT_SET, Continuous, Epsilon, Limits, Noise, Observation
from pydantic import ValidationError


def said(refused: pytest.ExceptionInfo[Any]) -> str:
    """The one thing that is wrong, and which setting it is of."""
    if not isinstance(refused.value, ValidationError):
        text = str(refused.value)
        assert "\n" not in text
        return text
    (error,) = refused.value.errors()
    return f"{'.'.join(map(str, error['loc']))}: {error['msg']}"


@pytest.mark.parametrize(
    ("kind", "near"),
    [("atHRL", "athrl"), ("hdpg", "hddpg"), ("h-dqn", "hdqn"), ("dpg", "ddpg"), ("athlr", "athrl")],
)
def test_unknown_planner_is_refused_with_the_nearest_name(kind: str, near: str) -> None:
    with pytest.raises(UnknownPlanner) as refused:
        make_agent(kind)
    expected = f"there is no planner {kind!r}, there are athrl, hddpg, ddpg, hdqn; did you mean {near}?"
    assert said(refused) == expected


def test_planner_like_nothing_there_is_gets_the_list_alone() -> None:
    with pytest.raises(UnknownPlanner) as refused:
        planner("zzzzz")
    assert said(refused) == "there is no planner 'zzzzz', there are athrl, hddpg, ddpg, hdqn"


@pytest.mark.parametrize(
    ("kind", "key"),
    [
        ("athrl", "epsilon_low"),
        ("hddpg", "intention_gradient"),
        ("ddpg", "trajectory_view"),
        ("hdqn", "update_rule"),
        ("hdqn", "noise_low"),
        ("athrl", "learning_rte"),
    ],
)
def test_settings_that_a_planner_does_not_have_are_refused(kind: str, key: str) -> None:
    with pytest.raises(ValidationError) as refused:
        make_agent(kind, {key: 1})
    assert said(refused) == f"{key}: Extra inputs are not permitted"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("n_step", 1.5),
        ("n_step", "3"),
        ("n_step", 0),
        ("discount", 1.0),
        ("discount", float("nan")),
        ("learning_rate", True),
        ("learning_rate", float("inf")),
        ("critics", 3),
        ("memory", "gru"),
        ("shared_trunk", "yes"),
        ("update_rule", "dqn"),
        ("atoms", 2),
        ("intention_every", 0),
    ],
)
def test_wrong_values_are_refused_by_name(key: str, value: Any) -> None:
    with pytest.raises(ValidationError) as refused:
        make_agent("athrl", {key: value})
    assert said(refused).startswith(f"{key}: ")


@pytest.mark.parametrize(
    ("kind", "settings", "message"),
    [
        (
            "athrl",
            {"value_min": 5.0, "value_max": 5.0},
            "planner.value_min = 5: should be below planner.value_max = 5",
        ),
        (
            "hdqn",
            {"value_min": 30.0},
            "planner.value_min = 30: should be below planner.value_max = 24",
        ),
        (
            "ddpg",
            {"mirror": True, "memory": "lstm"},
            'planner.mirror = true: should be false with planner.memory = "lstm", as remembered states '
            "cannot be mirrored",
        ),
        (
            "hddpg",
            {"noise_low": 0.5},
            "planner.noise_low = 0.5: should be at most planner.noise_high = 0.4",
        ),
        (
            "hdqn",
            {"epsilon_low": 0.3},
            "planner.epsilon_low = 0.3: should be at most planner.epsilon_high = 0.2",
        ),
    ],
)
def test_settings_that_contradict_each_other_are_refused(
    kind: str, settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValidationError) as refused:
        make_agent(kind, settings)
    assert said(refused) == f": Value error, {message}"


def test_every_setting_is_described_and_its_default_passes() -> None:
    for kind, found in planners().items():
        assert found.kind == kind
        assert found.summary
        assert found.settings.__doc__
        found.settings.model_validate(found.settings().model_dump())
        for name, field in found.settings.model_fields.items():
            assert field.description, name


def agent_of(found: type[Planner]) -> Agent:
    return Agent(found, found.settings(), Observation(8), Limits(), seed=1)


def a_planner(
    kind_of_action: str, *plans: LevelPlan, table: type[Any] = ActorCriticSettings
) -> type[Planner]:
    class Wrong(Planner):
        kind = "wrong"
        summary = "a planner that cannot be"
        settings: ClassVar[Any] = table
        action_kind = kind_of_action

        @classmethod
        def levels(cls, settings: Any, limits: Limits) -> tuple[LevelPlan, ...]:
            return plans

    return Wrong


SPEED = Continuous("target_speed", "m/s", 0.0, 8.0)
ANGLE = Continuous("waypoint_angle", "rad", -0.5, 0.5)
FREE = Noise(0.1, 0.1)


class Choosing(Planner):
    action_kind = WAYPOINT_SET


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (a_planner(WAYPOINT), "a policy has 0 levels; it should have 1 to 16"),
        (
            a_planner(WAYPOINT, LevelPlan("trajectory", (SPEED,), "td3")),
            "no level decides waypoint_angle, which actions of kind waypoint need",
        ),
        (
            a_planner(DIRECT, LevelPlan("trajectory", (SPEED, ANGLE), "td3")),
            "no level decides acceleration, which actions of kind direct need",
        ),
        (
            a_planner("sideways", LevelPlan("trajectory", (SPEED, ANGLE), "td3")),
            "there is no kind of action 'sideways'; there are waypoint, waypoint-set, direct",
        ),
        (
            a_planner(WAYPOINT, LevelPlan("one", (SPEED,), "td3"), LevelPlan("one", (ANGLE,), "td3")),
            "the level 'one' comes twice",
        ),
        (
            a_planner(WAYPOINT, LevelPlan("one", (SPEED, ANGLE, SPEED), "td3")),
            "the action 'target_speed' comes twice",
        ),
        (
            a_planner(
                WAYPOINT_SET,
                LevelPlan(
                    "one", (Continuous("behaviour", "", 0, 2), Continuous("waypoint", "", 0, 15)), "td3"
                ),
            ),
            "behaviour is a number; actions of kind waypoint-set need a choice of 3",
        ),
        (
            a_planner(WAYPOINT_SET, LevelPlan("one", Choosing.actions(Limits(), Epsilon(0, 0)), "td3")),
            "level one learns by td3 and decides a choice: use dqn",
        ),
        (
            a_planner(
                WAYPOINT_SET,
                LevelPlan("one", Choosing.actions(Limits(), Epsilon(0, 0)), "dqn"),
                table=QLearningSettings,
            ),
            "level one learns by dqn: it should decide one choice and nothing else",
        ),
        (
            a_planner(WAYPOINT, LevelPlan("one", (SPEED, ANGLE), "td3", gradient_from_below=1.0)),
            "level one takes a gradient from below, where there is no level that decides numbers",
        ),
        (
            a_planner(WAYPOINT, LevelPlan("one", (SPEED, ANGLE), "ppo")),  # type: ignore[arg-type]
            "there is no update rule 'ppo'; there are ddpg, td3, sac, dqn",
        ),
    ],
)
def test_planner_that_does_not_decide_what_its_environment_needs_is_refused(
    found: type[Planner], message: str
) -> None:
    with pytest.raises(ValueError) as refused:  # noqa: PT011  (the whole text is compared)
        agent_of(found)
    assert said(refused) == message


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"actions": ()}, "level one decides nothing"),
        ({"every": 0}, "level one decides every 0 decisions; should be 1 or more"),
        (
            {"update_rule": "dqn", "gradient_from_below": 1.0},
            "level one learns by dqn: it has no actor that a gradient could climb",
        ),
        (
            {"rewarded": ("speed", "haste")},
            "level one has the reward term 'haste'; there are collision, speed, fast, out, steer, "
            "lateral, constant",
        ),
        (
            {"rewarded": ("speed", "out", "speed")},
            "level one has the reward term 'speed' twice; once is enough",
        ),
    ],
)
def test_level_that_cannot_be_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as refused:  # noqa: PT011  (the whole text is compared)
        LevelPlan(**{"name": "one", "actions": (SPEED, ANGLE), "update_rule": "td3", **changes})
    assert said(refused) == message


@pytest.mark.parametrize(
    ("place", "message"),
    [
        (
            "nowhere.to_be:Found",
            "the planner mine cannot be loaded from nowhere.to_be:Found: ModuleNotFoundError: No module",
        ),
        ("athrl_planners.athrl:Nobody", "the planner mine cannot be loaded from athrl_planners.athrl:Nobody"),
        ("athrl_planners.settings:PlannerSettings", "it should be a Planner"),
        ("athrl_planners.athrl:AtHRL", "calls itself 'athrl', it is registered as 'mine'"),
        ("athrl_planners.planner:Planner", "has no kind, which it should say"),
    ],
)
def test_planner_that_cannot_be_loaded_is_refused_by_name(
    monkeypatch: pytest.MonkeyPatch, fresh_registry: Callable[[], None], place: str, message: str
) -> None:
    monkeypatch.setitem(registry.PLANNERS, "mine", place)
    fresh_registry()
    with pytest.raises(UnknownPlanner) as refused:
        planners()
    assert message in said(refused)


def test_planner_whose_module_fails_in_whatever_way_is_refused_by_name(
    monkeypatch: pytest.MonkeyPatch, fresh_registry: Callable[[], None], tmp_path: Path
) -> None:
    (tmp_path / "broken_planner.py").write_text("SPEEDS = {}\nSLOW = SPEEDS['slow']\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(registry.PLANNERS, "mine", "broken_planner:Mine")
    fresh_registry()
    with pytest.raises(UnknownPlanner) as refused:
        planners()
    assert said(refused) == "the planner mine cannot be loaded from broken_planner:Mine: KeyError: 'slow'"
