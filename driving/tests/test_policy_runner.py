"""The ONNX runner against hand-written graphs and against a planner's own export."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import onnx.parser
import pytest
from athrl_driving.policy import InvalidPolicy, OnnxPolicy

METADATA = {
    "schema_version": 1,
    "planner": "test",
    "observation": {"image": [8, 8, 4], "motion": ["speed_over_8", "steering_over_0.3"]},
    "levels": [
        {
            "name": "intention",
            "state_size": 3,
            "actions": [
                {"name": "intention", "unit": "", "low": 0, "high": 2}
                | {"noise": "ornstein-uhlenbeck", "noise_scale": 0.2, "damping": 0.15}
            ],
        },
        {
            "name": "trajectory",
            "state_size": 2,
            "actions": [
                {"name": "target_speed", "unit": "m/s", "low": 0, "high": 8}
                | {"noise": "ornstein-uhlenbeck", "noise_scale": 0.2, "damping": 0.15},
                {"name": "waypoint_angle", "unit": "rad", "low": -0.5, "high": 0.5}
                | {"noise": "gaussian", "noise_scale": 0.1, "damping": 0},
            ],
        },
    ],
}

# The intention is 1 unless noise or force say otherwise, the target speed 2 + intention, the angle the mean
# motion; the states count decisions, by ones and by twos.
GRAPH = """
<ir_version: 8, opset_import: ["" : 17]>
policy (uint8[N,8,8,4] image, float[N,2] motion, float[N,3] intention_state, float[N,2] trajectory_state,
        float[N,1] intention_noise, float[N,1] forced_intention)
    => (float[N,1] intention, float[N,2] trajectory,
        float[N,3] next_intention_state, float[N,2] next_trajectory_state)
{
    one = Constant <value_float: float = 1.0> ()
    two = Constant <value_float: float = 2.0> ()
    nothing = Constant <value_float: float = 0.0> ()
    pixels = Cast <to: int = 1> (image)
    bright = ReduceMean <axes: ints = [1, 2, 3], keepdims: int = 0> (pixels)
    row = Unsqueeze (bright, axis)
    unlit = Mul (row, nothing)
    plain = Add (unlit, one)
    noisy = Add (plain, intention_noise)
    free = IsNaN (forced_intention)
    chosen = Where (free, noisy, forced_intention)
    intention = Clip (chosen, nothing, two)
    speed = Add (intention, two)
    angle = ReduceMean <axes: ints = [1], keepdims: int = 1> (motion)
    trajectory = Concat <axis: int = 1> (speed, angle)
    next_intention_state = Add (intention_state, one)
    next_trajectory_state = Add (trajectory_state, two)
}
"""


def artefact(metadata: object = METADATA, graph: str = GRAPH) -> bytes:
    model = onnx.parser.parse_model(graph)
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.array([1]), "axis"))
    if metadata is not None:
        text = metadata if isinstance(metadata, str) else json.dumps(metadata)
        onnx.helper.set_model_props(model, {"athrl": text})
    return model.SerializeToString()


def observe(batch: int) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((batch, 8, 8, 4), np.uint8), np.full((batch, 2), 0.25, np.float32)


def changed(**changes: object) -> dict:
    return json.loads(json.dumps(METADATA)) | changes


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


def test_noise_of_the_acting_level_never_leaves_the_range():
    policy = OnnxPolicy(artefact())
    noise = {"trajectory": np.array([[100.0, -100.0]], np.float32)}
    step = policy.step(*observe(1), policy.initial_states(1), noise=noise)
    np.testing.assert_allclose(step.actions["trajectory"], [[8.0, -0.5]])


def test_physical_actions_become_the_environments_actions():
    level = OnnxPolicy(artefact()).metadata.acting_level
    physical = np.array([[0.0, -0.5], [4.0, 0.0], [8.0, 0.5]], np.float32)
    np.testing.assert_allclose(level.normalised(physical), [[-1, -1], [0, 0], [1, 1]])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "ONNX Runtime cannot open it"),
        (b"this is a text", "ONNX Runtime cannot open it"),
        (artefact(metadata=None), "no 'athrl' metadata"),
        (artefact(metadata="no json"), "not JSON"),
        (artefact(metadata="[]"), "not a JSON object"),
        (artefact(metadata=changed(schema_version=2)), "schema version 2; this program reads 1"),
        (artefact(metadata=changed(levels=[])), "no level"),
        (artefact(metadata=changed(levels=METADATA["levels"][:1])), "inputs are"),
        (artefact(metadata=changed(observation={"image": [8, 8], "motion": []})), "three sizes"),
        (
            artefact(metadata=changed(observation={"image": [16, 16, 4], "motion": ["speed", "steering"]})),
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
    with pytest.raises(InvalidPolicy, match=r"cannot read the policy .*nothing.onnx: No such file"):
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
