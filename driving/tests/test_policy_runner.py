"""The ONNX runner against hand-written graphs and against a planner's own export."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import onnx.parser
import pytest
from athrl_driving.policy import InvalidPolicy, OnnxPolicy
from athrl_spaces import (
    WAYPOINT,
    WAYPOINT_SET,
    Continuous,
    LevelDescription,
    Limits,
    Noise,
    Observation,
    PolicyDescription,
    action_kind,
)

DESCRIPTION = PolicyDescription(
    planner="test",
    action_kind=WAYPOINT,
    limits=Limits(8.0, 8.0, 0.5),
    observation=Observation(8),
    levels=(
        LevelDescription("intention", (Continuous("intention", "", 0, 2, Noise(0.2, 0.2)),), 3),
        LevelDescription(
            "trajectory",
            (
                Continuous("target_speed", "m/s", 0, 8, Noise(0.2, 0.2)),
                Continuous("waypoint_angle", "rad", -0.5, 0.5, Noise(0.1, 0.1, 1.0), sideways=True),
            ),
            2,
        ),
    ),
)
METADATA = json.loads(DESCRIPTION.to_json())

# The intention is 1 unless noise or forcing change it, the target speed 2 + intention, the angle the mean
# motion; the states count decisions, by ones and by twos.
GRAPH = """
<ir_version: 8, opset_import: ["" : 17]>
policy (uint8[N,8,8,4] image, float[N,2] motion, float[N,3] intention_state, float[N,2] trajectory_state,
        float[N,1] intention_noise, float[N,1] forced_intention,
        float[N,2] trajectory_noise, float[N,2] forced_trajectory)
    => (float[N,1] intention, float[N,2] trajectory,
        float[N,3] next_intention_state, float[N,2] next_trajectory_state)
{
    one = Constant <value_float: float = 1.0> ()
    two = Constant <value_float: float = 2.0> ()
    nothing = Constant <value_float: float = 0.0> ()
    lowest = Constant <value_floats: floats = [0.0, -0.5]> ()
    highest = Constant <value_floats: floats = [8.0, 0.5]> ()
    pixels = Cast <to: int = 1> (image)
    bright = ReduceMean <axes: ints = [1, 2, 3], keepdims: int = 0> (pixels)
    row = Unsqueeze (bright, axis)
    unlit = Mul (row, nothing)
    plain = Add (unlit, one)
    noisy = Add (plain, intention_noise)
    within = Clip (noisy, nothing, two)
    free = IsNaN (forced_intention)
    intention = Where (free, within, forced_intention)
    speed = Add (intention, two)
    angle = ReduceMean <axes: ints = [1], keepdims: int = 1> (motion)
    decided = Concat <axis: int = 1> (speed, angle)
    loud = Add (decided, trajectory_noise)
    at_least = Max (loud, lowest)
    bounded = Min (at_least, highest)
    open = IsNaN (forced_trajectory)
    trajectory = Where (open, bounded, forced_trajectory)
    next_intention_state = Add (intention_state, one)
    next_trajectory_state = Add (trajectory_state, two)
}
"""

CHOICES = PolicyDescription(
    planner="test",
    action_kind=WAYPOINT_SET,
    limits=Limits(),
    observation=Observation(8),
    levels=tuple(
        LevelDescription(action.name, (action,)) for action in action_kind(WAYPOINT_SET).describe(Limits())
    ),
)

# Without memory and noise: the behaviour is the first entry of motion, the waypoint five more than that.
CHOICES_GRAPH = """
<ir_version: 8, opset_import: ["" : 17]>
policy (uint8[N,8,8,4] image, float[N,2] motion, float[N,1] forced_behaviour, float[N,1] forced_waypoint)
    => (float[N,1] behaviour, float[N,1] waypoint)
{
    five = Constant <value_float: float = 5.0> ()
    first, second = Split <axis: int = 1> (motion)
    free = IsNaN (forced_behaviour)
    behaviour = Where (free, first, forced_behaviour)
    more = Add (behaviour, five)
    open = IsNaN (forced_waypoint)
    waypoint = Where (open, more, forced_waypoint)
}
"""


def artefact(metadata: object = METADATA, graph: str = GRAPH) -> bytes:
    model = onnx.parser.parse_model(graph)
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.array([1]), "axis"))
    if metadata is not None:
        text = metadata if isinstance(metadata, str) else json.dumps(metadata)
        onnx.helper.set_model_props(model, {"athrl": text})
    return model.SerializeToString()


def choosing() -> OnnxPolicy:
    return OnnxPolicy(artefact(json.loads(CHOICES.to_json()), CHOICES_GRAPH))


def observe(batch: int) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((batch, 8, 8, 4), np.uint8), np.full((batch, 2), 0.25, np.float32)


def changed(**changes: object) -> dict:
    return json.loads(json.dumps(METADATA)) | changes


def without_memory() -> dict:
    document = changed()
    for level in document["levels"]:
        level["state_size"] = 0
    return document


def test_recurrent_states_are_the_callers_and_are_carried_on():
    policy = OnnxPolicy(artefact())
    images, motion = observe(4)
    states = policy.initial_states(4)
    for count in range(1, 4):
        states = policy.step(images, motion, states).states
        np.testing.assert_array_equal(states["intention"], np.full((4, 3), count))
        np.testing.assert_array_equal(states["trajectory"], np.full((4, 2), 2 * count))


def test_a_lower_level_sees_the_noisy_action_of_the_level_above():
    policy = OnnxPolicy(artefact())
    noise = {"intention": np.array([[0.5], [-3.0]], np.float32)}
    step = policy.step(*observe(2), policy.initial_states(2), noise=noise)
    np.testing.assert_allclose(step.actions["intention"], [[1.5], [0.0]])
    np.testing.assert_allclose(step.actions["trajectory"], [[3.5, 0.25], [2.0, 0.25]])


def test_a_level_can_be_forced_in_one_environment_and_free_in_another():
    policy = OnnxPolicy(artefact())
    forced = {
        "intention": np.array([[np.nan], [2.0]], np.float32),
        "trajectory": np.array([[7.0, -0.5], [np.nan, np.nan]], np.float32),
    }
    step = policy.step(*observe(2), policy.initial_states(2), forced=forced)
    np.testing.assert_allclose(step.actions["intention"], [[1.0], [2.0]])
    np.testing.assert_allclose(step.actions["trajectory"], [[7.0, -0.5], [4.0, 0.25]])


def test_noise_reaches_the_last_level_too():
    policy = OnnxPolicy(artefact())
    noise = {"trajectory": np.array([[100.0, -100.0], [1.0, 0.125]], np.float32)}
    step = policy.step(*observe(2), policy.initial_states(2), noise=noise)
    np.testing.assert_allclose(step.actions["trajectory"], [[8.0, -0.5], [4.0, 0.375]])


def test_what_is_forced_beyond_a_range_is_its_bound():
    policy = OnnxPolicy(artefact())
    forced = {"trajectory": np.array([[99.0, np.nan]], np.float32)}
    step = policy.step(*observe(1), policy.initial_states(1), forced=forced)
    np.testing.assert_allclose(step.actions["trajectory"], [[8.0, 0.25]])


def test_decisions_become_the_environments_actions():
    description = OnnxPolicy(artefact()).description
    assert description == DESCRIPTION
    physical = {"trajectory": np.array([[0.0, -0.5], [4.0, 0.0], [8.0, 0.5]], np.float32)}
    np.testing.assert_allclose(description.environment_action(physical), [[-1, -1], [0, 0], [1, 1]])


def test_a_policy_of_choices_without_memory_has_no_noise_and_empty_states():
    policy = choosing()
    images, motion = observe(2)
    motion[:, 0] = [2.0, 0.0]
    states = policy.initial_states(2)
    assert {name: state.shape for name, state in states.items()} == {"behaviour": (2, 0), "waypoint": (2, 0)}
    step = policy.step(images, motion, states)
    np.testing.assert_array_equal(step.actions["behaviour"], [[2], [0]])
    np.testing.assert_array_equal(policy.description.environment_action(step.actions), [[2, 7], [0, 5]])
    assert {name: state.shape for name, state in step.states.items()} == {
        "behaviour": (2, 0),
        "waypoint": (2, 0),
    }
    forced = {"behaviour": np.array([[1.0], [np.nan]], np.float32)}
    step = policy.step(images, motion, step.states, forced=forced)
    np.testing.assert_array_equal(step.actions["behaviour"], [[1], [0]])
    np.testing.assert_array_equal(step.actions["waypoint"], [[6], [5]])


@pytest.mark.parametrize(("choice", "said"), [(3.0, "as 3"), (-1.0, "as -1"), (0.5, "as 0.5")])
def test_an_unknown_choice_is_the_policys_fault(choice: float, said: str):
    images, motion = observe(2)
    motion[:, 0] = [1.0, choice]
    with pytest.raises(
        InvalidPolicy, match=f"decided behaviour {said}; it should be a whole number from 0 to 2"
    ):
        choosing().step(images, motion, {})


def test_a_number_beyond_its_range_is_the_policys_fault():
    policy = OnnxPolicy(artefact(graph=GRAPH.replace("Min (at_least, highest)", "Add (at_least, highest)")))
    with pytest.raises(InvalidPolicy, match=r"decided target_speed as 11; it should be from 0 to 8"):
        policy.step(*observe(1), policy.initial_states(1))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "it is not an ONNX file, or an empty one"),
        (b"this is a text", "it is not an ONNX file"),
        (
            artefact(graph=GRAPH.replace("Add (unlit, one)", "Softmax <axis: int = 9> (unlit)")),
            "ONNX Runtime cannot open it",
        ),
        (artefact(metadata=None), "no 'athrl' metadata"),
        (artefact(metadata="no json"), "not JSON"),
        (artefact(metadata="[]"), "not a JSON object"),
        (artefact(metadata=changed(schema_version=1)), "schema version 1; this program reads 2"),
        (artefact(metadata=changed(levels=[])), "0 levels"),
        (artefact(metadata=changed(levels=METADATA["levels"][:1])), "no level decides target_speed"),
        (artefact(metadata=changed(action_kind="flight")), "no kind of action 'flight'"),
        (artefact(metadata=json.loads(CHOICES.to_json())), "inputs are"),
        (
            artefact(metadata=changed(observation=METADATA["observation"] | {"channels": 4})),
            "'channels' is 4",
        ),
        (artefact(metadata=without_memory()), "inputs are"),
        (
            artefact(metadata=changed(observation=METADATA["observation"] | {"image_size": 16})),
            r"'image' is tensor\(uint8\)",
        ),
        (artefact(graph=GRAPH.replace("uint8[N,8,8,4]", "float[N,8,8,4]")), r"'image' is tensor\(float\)"),
    ],
)
def test_a_file_that_is_no_policy_is_one_line_that_names_it(tmp_path: Path, content: bytes, said: str):
    file = tmp_path / "some.onnx"
    file.write_bytes(content)
    with pytest.raises(InvalidPolicy, match=said) as caught:
        OnnxPolicy.load(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_one_line_that_names_it(tmp_path: Path):
    with pytest.raises(InvalidPolicy, match=r"the policy .*nothing.onnx cannot be read: no such file"):
        OnnxPolicy.load(tmp_path / "nothing.onnx")


def test_values_that_are_not_finite_are_refused():
    policy = OnnxPolicy(artefact())
    states = policy.initial_states(1)
    states["trajectory"][:] = np.inf
    with pytest.raises(InvalidPolicy, match="not finite"):
        policy.step(*observe(1), states)


def test_without_its_extra_the_missing_package_is_named_with_how_to_get_it() -> None:
    program = "import sys; sys.modules['onnxruntime'] = None; import athrl_driving.policy"
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert result.returncode == 1
    assert result.stderr.splitlines()[-1].endswith("pip install 'athrl-driving[policy]'")


_RUN_A_POLICY = """
import os, sys
from athrl_driving.policy import OnnxPolicy
OnnxPolicy.load(sys.argv[1])
print(os.environ["ORT_DISABLE_TELEMETRY"])
"""


@pytest.mark.parametrize("chosen", [None, "0"])
def test_a_policy_leaves_nothing_in_the_home_unless_its_owner_wants_telemetry(
    tmp_path: Path, chosen: str | None
) -> None:
    file, home = tmp_path / "some.onnx", tmp_path / "home"
    file.write_bytes(artefact())
    home.mkdir()
    outside = {name: value for name, value in os.environ.items() if not name.startswith(("ORT_", "XDG_"))}
    choice = {} if chosen is None else {"ORT_DISABLE_TELEMETRY": chosen}
    result = subprocess.run(
        [sys.executable, "-c", _RUN_A_POLICY, str(file)],
        env={**outside, **choice, "HOME": str(home)}, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == (chosen or "1")
    # With telemetry ONNX Runtime writes files when it likes, or never: only without it is the home sure.
    if chosen is None:
        assert not any(path.is_file() for path in home.rglob("*"))
