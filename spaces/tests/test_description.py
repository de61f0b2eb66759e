"""The description of a policy survives its JSON, and invalid JSON is refused in one line."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from athrl_spaces import (
    DIRECT,
    REWARD_TERMS,
    WAYPOINT,
    WAYPOINT_SET,
    Continuous,
    Discrete,
    Epsilon,
    InvalidDescription,
    LevelDescription,
    Limits,
    Noise,
    Observation,
    PolicyDescription,
    Sampled,
    action_kind,
    indices_of_terms,
)
from hypothesis import given, settings
from hypothesis import strategies as st

LIMITS = Limits(maximum_speed=10.0, waypoint_half_angle=0.5)


def described(kind: str, *above: LevelDescription, exploration: Any = None) -> PolicyDescription:
    actions = action_kind(kind).describe(LIMITS)
    if exploration is not None:
        actions = tuple(replace(action, exploration=exploration) for action in actions)  # type: ignore[misc]
    levels = (*above, LevelDescription("lowest", actions, 12))
    return PolicyDescription("a planner", kind, LIMITS, Observation(16), levels)


INTENTION = LevelDescription(
    "intention", (Continuous("intention", "", 0.0, 2.0, Noise(0.2, 0.2, 0.3), sideways=True),), 5
)
ALL = {
    "hierarchy": described(WAYPOINT, INTENTION, exploration=Noise(0.05, 0.4)),
    "sampled": described(WAYPOINT, exploration=Sampled()),
    "direct": described(DIRECT),
    "choices": described(WAYPOINT_SET, exploration=Epsilon(0.02, 0.2)),
    "paid differently": described(WAYPOINT, replace(INTENTION, rewarded=("collision", "speed"))),
}


@pytest.mark.parametrize("description", ALL.values(), ids=ALL)
def test_description_survives_its_json(description: PolicyDescription) -> None:
    assert PolicyDescription.from_json(description.to_json()) == description


def test_environment_takes_numbers_normalised_by_its_own_range() -> None:
    actions = {
        "intention": np.float32([[1.0], [0.0]]),
        "lowest": np.float32([[10.0, 0.25], [5.0, -0.5]]),
    }
    taken = ALL["hierarchy"].environment_action(actions)
    assert taken.dtype == np.float32
    np.testing.assert_allclose(taken, [[1.0, 0.5], [0.0, -1.0]])


def test_planner_of_a_narrower_range_means_the_same_numbers() -> None:
    slow = LevelDescription("slow", (Continuous("target_speed", "m/s", 0.0, 5.0),))
    steer = LevelDescription("steer", (Continuous("waypoint_angle", "rad", -0.1, 0.1),))
    policy = PolicyDescription("mine", WAYPOINT, LIMITS, Observation(16), (steer, slow))
    taken = policy.environment_action({"slow": np.float32([[5.0]]), "steer": np.float32([[0.1]])})
    np.testing.assert_allclose(taken, [[0.0, 0.2]], atol=1e-6)


def test_environment_takes_no_number_beyond_its_range() -> None:
    taken = ALL["direct"].environment_action({"lowest": np.float32([[3.1, -0.4]])})
    np.testing.assert_array_equal(taken, [[1.0, -1.0]])


def test_environment_takes_choices_as_they_are() -> None:
    taken = ALL["choices"].environment_action({"lowest": np.float32([[2, 13]])})
    np.testing.assert_array_equal(taken, [[2, 13]])


def test_everything_that_was_decided_has_a_name() -> None:
    actions = {"intention": np.float32([[1.0], [0.5]]), "lowest": np.float32([[9.0, 0.1], [4.0, -0.25]])}
    values = ALL["hierarchy"].named_values(actions, 1)
    assert values == {"intention": 0.5, "target_speed": 4.0, "waypoint_angle": -0.25}
    assert ALL["hierarchy"].entries == list(values)


def test_level_of_which_nothing_is_said_is_paid_the_tasks_reward() -> None:
    document = json.loads(ALL["hierarchy"].to_json())
    for level in document["levels"]:
        assert level.pop("rewarded") == []
    assert PolicyDescription.from_json(json.dumps(document)) == ALL["hierarchy"]


def test_file_without_a_speed_gain_was_made_for_the_one_of_the_release() -> None:
    document = json.loads(ALL["hierarchy"].to_json())
    assert document["limits"].pop("speed_gain") == 2.0
    assert PolicyDescription.from_json(json.dumps(document)).limits.speed_gain == 0.7
    document["limits"]["speed_gain"] = 3.0
    assert PolicyDescription.from_json(json.dumps(document)).limits.speed_gain == 3.0


def test_terms_that_a_level_is_paid_are_found_by_their_names() -> None:
    assert indices_of_terms(("speed", "collision")) == (0, 1)
    assert [REWARD_TERMS[place] for place in indices_of_terms(("constant", "out"))] == ["out", "constant"]
    assert indices_of_terms(()) == indices_of_terms(REWARD_TERMS[::-1]) == ()


def test_levels_know_their_bounds() -> None:
    level = ALL["choices"].levels[0]
    assert (level.low.tolist(), level.high.tolist(), level.action_size) == ([0, 0], [2, 15], 2)


def changed(path: tuple[Any, ...], value: Any) -> Callable[[], str]:
    def make() -> str:
        document = json.loads(ALL["hierarchy"].to_json())
        place = document
        for key in path[:-1]:
            place = place[key]
        if value is KeyError:
            del place[path[-1]]
        else:
            place[path[-1]] = value
        return json.dumps(document)

    return make


ACTION = ("levels", 1, "actions", 0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (lambda: "not JSON", "its metadata is not JSON: "),
        (lambda: "[" * 100_000, "its metadata is not JSON: "),
        (lambda: "[1, 2]", "its metadata is not a JSON object"),
        (changed(("schema_version",), 1), "it has schema version 1; this program reads 2"),
        (changed(("schema_version",), KeyError), "it has schema version None; this program reads 2"),
        (changed(("planner",), 5), "its metadata: 'planner' is 5, not of type str"),
        (changed(("action_kind",), "fly"), "its metadata: there is no kind of action 'fly'; there are"),
        (
            changed(("action_kind",), "direct"),
            "its metadata: no level decides acceleration, which actions of kind direct need",
        ),
        (changed(("limits", "maximum_speed"), 0), "its metadata: limits.maximum_speed is 0; it should be"),
        (changed(("limits", "waypoint_radius"), float("nan")), "it should be a finite number"),
        (changed(("limits", "waypoint_radius"), 10**400), "it should be a finite number"),
        (changed(("observation", "image_size"), 4), "its metadata: image_size is 4; it should be 8 or more"),
        (changed(("observation", "image_size"), True), "'image_size' is True, not of type int"),
        (changed(("observation", "channels"), "route"), "'channels' is 'route', not of type list"),
        (changed(("observation", "motion"), [1]), "'motion' is [1]; it should be a list of texts"),
        (changed(("levels",), []), "a policy has 0 levels; it should have 1 to 16"),
        (changed(("levels", 0), 3), "a level is 3; it should be an object"),
        (changed(("levels", 0, "name"), "lowest"), "the level 'lowest' comes twice"),
        (changed(("levels", 0, "state_size"), -1), "intention.state_size is -1; it should be 0 to 65536"),
        (changed(("levels", 0, "state_size"), 10**9), "intention.state_size is 1000000000; it should be"),
        (changed(("levels", 0, "actions"), []), "level 'intention' decides nothing"),
        (changed(("levels", 0, "rewarded"), ["haste"]), "level intention has the reward term 'haste'"),
        (changed(("levels", 0, "rewarded"), ["out", "out"]), "level intention has the reward term 'out'"),
        (changed(("levels", 0, "rewarded"), "speed"), "'rewarded' is 'speed', not of type list"),
        (changed(("levels", 0, "rewarded"), [1]), "'rewarded' is [1]; it should be a list of texts"),
        (changed(("observation", "image_size"), 10**9), "image_size is 1000000000; it should be at most 512"),
        (changed(("observation", "channels"), ["x"] * 65), "'channels' has 65 entries, at most 64 may be"),
        (changed(("levels", 0, "name"), "a\nb"), "'name' is 'a\\nb'; it should be short and printable"),
        (changed((*ACTION, "high"), 1e300), "'high' is 1e+300; it should be -1e+09 to 1e+09"),
        (changed((*ACTION, "name"), "x" * 300), "it should be short and printable"),
        (lambda: " " * 2**21, "its metadata has 2,097,152 characters; at most 1,048,576"),
        (changed((*ACTION, "type"), "fuzzy"), "an action of 'lowest' is 'fuzzy'; should be continuous or"),
        (changed((*ACTION, "type"), KeyError), "'type' is None, not of type str"),
        (changed((*ACTION, "name"), "intention"), "the action 'intention' comes twice"),
        (changed((*ACTION, "low"), 99), "the range of target_speed is 99.0..10.0; low must be below high"),
        (changed((*ACTION, "low"), "0"), "'low' is '0'; it should be a number"),
        (changed((*ACTION, "exploration"), {"low": 1, "high": 0, "damping": 1}), "they should rise from 0"),
        (changed((*ACTION, "exploration"), "sometimes"), "'exploration' is 'sometimes', not of type dict"),
    ],
)
def test_anything_else_is_refused_in_one_line(text: Callable[[], str], message: str) -> None:
    with pytest.raises(InvalidDescription) as refused:
        PolicyDescription.from_json(text())
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300


def choosing(**changes: Any) -> str:
    document = json.loads(ALL["choices"].to_json())
    document["levels"][0]["actions"][1] |= changes
    return json.dumps(document)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (choosing(choices=["left", "right"], mirrored=[]), "waypoint is a choice of 2; actions of kind"),
        (choosing(choices=["here"] * 5000, mirrored=[]), "'choices' has 5,000 entries, at most 4,096 may be"),
        (choosing(mirrored=[0.5]), "a mirrored choice is 0.5; it should be a whole number"),
        (choosing(mirrored=7), "its metadata: 'mirrored' is 7, not of type list"),
        (choosing(exploration={"low": 0.5, "high": 2}), "epsilon is 0.5..2.0; it should rise within 0..1"),
    ],
)
def test_wrong_choices_are_refused_in_one_line(text: str, message: str) -> None:
    with pytest.raises(InvalidDescription) as refused:
        PolicyDescription.from_json(text)
    assert message in str(refused.value)


def test_number_where_a_choice_is_needed_is_refused() -> None:
    actions = (Continuous("behaviour", "", 0, 2), Discrete("waypoint", ("a",) * 16))
    with pytest.raises(ValueError, match="behaviour is a number; actions of kind waypoint-set need a choice"):
        PolicyDescription("mine", WAYPOINT_SET, LIMITS, Observation(16), (LevelDescription("one", actions),))


def places(document: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The path to everything within a document."""
    if not isinstance(document, (dict, list)):
        return []
    keys = document if isinstance(document, dict) else range(len(document))
    return [found for key in keys for found in [(*path, key), *places(document[key], (*path, key))]]


DOCUMENTS = [json.loads(description.to_json()) for description in ALL.values()]
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.lists(st.integers(), max_size=3),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
)


@given(st.sampled_from(DOCUMENTS), st.data())
@settings(max_examples=300, deadline=None)
def test_no_damage_to_a_document_raises_anything_else(document: dict[str, Any], data: st.DataObject) -> None:
    damaged = copy.deepcopy(document)
    *path, last = data.draw(st.sampled_from(places(document)))
    place = damaged
    for key in path:
        place = place[key]
    place[last] = data.draw(VALUES)
    try:
        read = PolicyDescription.from_json(json.dumps(damaged))
    except InvalidDescription:
        return
    assert PolicyDescription.from_json(read.to_json()) == read
