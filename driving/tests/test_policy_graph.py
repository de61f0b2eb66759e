"""A policy's graph is checked before ONNX Runtime sees it: what it may do, and how much of it."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import athrl_driving
import numpy as np
import onnx
import onnx.parser
import onnxruntime
import pytest
from athrl_driving.policy import InvalidPolicy, OnnxPolicy
from athrl_driving.policy.graph import OPERATORS, GraphCheck
from athrl_driving.policy.graph.values import Value
from athrl_spaces import WAYPOINT_SET, LevelDescription, Limits, Observation, PolicyDescription, action_kind
from onnx import TensorProto, helper, numpy_helper

ROOT = Path(__file__).parents[2]
DESCRIPTION = PolicyDescription(
    planner="test",
    action_kind=WAYPOINT_SET,
    limits=Limits(),
    observation=Observation(8),
    levels=tuple(
        LevelDescription(action.name, (action,)) for action in action_kind(WAYPOINT_SET).describe(Limits())
    ),
)
GRAPH = """
<ir_version: 8, opset_import: ["" : 17]>
policy (uint8[N,8,8,4] image, float[N,2] motion, float[N,1] forced_behaviour, float[N,1] forced_waypoint)
    => (float[N,1] behaviour, float[N,1] waypoint)
{
    zero = Constant <value_float: float = 0.0> ()
    first, second = Split <axis: int = 1> (motion)
    behaviour = Mul (first, zero)
    waypoint = Mul (second, zero)
}
"""
# Of every operator that exporters write for networks like those of planners; the shapes are of all kinds.
VARIED = """
<ir_version: 8, opset_import: ["" : 17]>
varied (uint8[N,8,8,4] image, float[N,2] motion) => (float[N,1] out)
<int64[1] one = {1}, int64[1] two = {2}, int64[1] last = {-1}, int64[2] flat = {0, -1}, int64 depth = {4},
 float[2] onoff = {0, 1}, int64[1] nought = {0}, int64[1] front = {-9223372036854775807}>
{
    pixels = Cast <to: int = 1> (image)
    turned = Transpose <perm: ints = [0, 3, 1, 2]> (pixels)
    rows = Slice (turned, nought, two, one)
    back = Slice (rows, last, front, two, last)
    kernel = ConstantOfShape <value: tensor = float[1] {0.5}> (window)
    window = Constant <value_ints: ints = [6, 2, 3, 3]> ()
    seen = Conv <pads: ints = [1, 0, 1, 2], strides: ints = [2, 1]> (back, kernel)
    small = MaxPool <kernel_shape: ints = [2, 3], strides: ints = [1, 2]> (seen)
    mean = AveragePool <kernel_shape: ints = [2, 2], pads: ints = [1, 1, 0, 0]> (small)
    left, right = Split <axis: int = 2> (mean, parts)
    parts = Constant <value_ints: ints = [1, 2]> ()
    pooled = GlobalAveragePool (right)
    vector = Flatten (pooled)
    shape = Shape (motion)
    count = Gather (shape, nought)
    six = Constant <value_ints: ints = [6]> ()
    size = Concat <axis: int = 0> (count, six)
    again = Reshape (vector, size)
    wide = Unsqueeze (again, last)
    narrow = Squeeze (wide, last)
    normal = Softmax <axis: int = 1> (narrow)
    best = ArgMax <axis: int = 1, keepdims: int = 0> (normal)
    chosen = OneHot <axis: int = 1> (best, depth, onoff)
    weights = ConstantOfShape <value: tensor = float[1] {0.25}> (square)
    square = Constant <value_ints: ints = [3, 4]> ()
    joined = Gemm <transB: int = 1> (chosen, weights)
    expanded = Expand (joined, triple)
    ones = Constant <value_ints: ints = [1, 3]> ()
    triple = Mul (ones, one)
    across = Unsqueeze (expanded, one)
    along = Unsqueeze (expanded, two)
    outer = MatMul (along, across)
    added = Add (outer, across)
    total = ReduceSum <keepdims: int = 0> (added, pair)
    pair = Constant <value_ints: ints = [1, 2]> ()
    line = Unsqueeze (total, one)
    half = ReduceMean <axes: ints = [1], keepdims: int = 1> (motion)
    free = IsNaN (half)
    out = Where (free, line, half)
}
"""


def model() -> onnx.ModelProto:
    made = onnx.parser.parse_model(GRAPH)
    helper.set_model_props(made, {"athrl": DESCRIPTION.to_json()})
    return made


def sorted_graph(text: str) -> onnx.ModelProto:
    """Return a graph whose nodes stand in the order in which they can be computed."""
    made = onnx.parser.parse_model(text)
    known = {each.name for each in [*made.graph.input, *made.graph.initializer]}
    waiting, ordered = list(made.graph.node), []
    while waiting:
        node = next(each for each in waiting if set(each.input) <= known | {""})
        waiting.remove(node)
        ordered.append(node)
        known.update(node.output)
    del made.graph.node[:]
    made.graph.node.extend(ordered)
    return made


def shipped() -> onnx.ModelProto:
    return onnx.load(ROOT / "services/evaluator/athrl_evaluator/policies/town03.onnx")


@pytest.mark.parametrize("make", [lambda: sorted_graph(VARIED), shipped], ids=["varied", "shipped"])
@pytest.mark.parametrize("batch", [1, 3])
def test_sizes_are_those_that_onnx_runtime_computes(make: Callable, batch: int) -> None:
    made = make()
    del made.graph.output[:]
    made.graph.output.extend(
        onnx.ValueInfoProto(name=name) for node in made.graph.node for name in node.output
    )
    types = {TensorProto.UINT8: np.uint8, TensorProto.FLOAT: np.float32}
    feed, inputs = {}, {}
    for each in made.graph.input:
        shape = [size.dim_value for size in each.type.tensor_type.shape.dim][1:]
        kind = each.type.tensor_type.elem_type
        feed[each.name] = np.ones((batch, *shape), types[kind])
        inputs[each.name] = Value((batch, *shape), kind)
    content = made.SerializeToString()
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    real = dict(zip([each.name for each in session.get_outputs()], session.run(None, feed), strict=True))
    told = GraphCheck(content).sizes(inputs)
    assert {name: value.shape for name, value in told.items()} == {name: v.shape for name, v in real.items()}
    kinds = {name: helper.np_dtype_to_tensor_dtype(value.dtype) for name, value in real.items()}
    assert {name: value.dtype for name, value in told.items()} == kinds
    for name, value in told.items():
        if value.known is not None:
            np.testing.assert_array_equal(value.known, real[name])


def put(made: onnx.ModelProto, *nodes: onnx.NodeProto, **constants: object) -> onnx.ModelProto:
    """Put nodes into the policy; the last one's output is added to the behaviour."""
    for name, value in constants.items():
        made.graph.initializer.append(numpy_helper.from_array(np.array(value), name))
    end = made.graph.node[-2]
    end.output[0] = "plain"
    total = helper.make_node("ReduceSum", [nodes[-1].output[0]], ["total"], keepdims=0)
    made.graph.node.extend([*nodes, total, helper.make_node("Add", ["plain", "total"], ["behaviour"])])
    return made


def node(kind: str, *inputs: str, gives: str = "x", **attributes: object) -> onnx.NodeProto:
    return helper.make_node(kind, list(inputs), [gives], **attributes)


def doubled(kind: str, times: int, **attributes: object) -> list[onnx.NodeProto]:
    names = ["motion", *(f"x{n}" for n in range(times))]
    return [node(kind, a, a, gives=b, **attributes) for a, b in pairwise(names)]


BOMBS: dict[str, tuple[Callable[[], onnx.ModelProto], str]] = {
    "constant of shape": (
        lambda: put(model(), node("ConstantOfShape", "shape"), shape=[10**6, 10**6]),
        "a decision takes over",
    ),
    "expand": (
        lambda: put(model(), node("Expand", "zero", "shape"), shape=[10**6, 10**6]),
        "decision takes over",
    ),
    "concat": (lambda: put(model(), *doubled("Concat", 60, axis=1)), "a decision takes over"),
    "shape of shapes": (
        lambda: put(
            model(),
            node("Shape", "motion", gives="motion1"),
            *[
                node("Concat", f"motion{n}", f"motion{n}", gives=f"motion{n + 1}", axis=0)
                for n in range(1, 60)
            ],
        ),
        "a decision takes over",
    ),
    "outer product": (
        lambda: put(
            model(),
            node("ConstantOfShape", "tall", gives="a"),
            node("ConstantOfShape", "wide", gives="b"),
            node("MatMul", "a", "b"),
            tall=[10**7, 1],
            wide=[1, 10**7],
        ),
        "a decision takes over",
    ),
    "long product": (
        lambda: put(
            model(), node("ConstantOfShape", "a", gives="a1"), node("MatMul", "a1", "a1"), a=[8000, 8000]
        ),
        "a decision takes over",
    ),
    "padded": (
        lambda: put(
            model(),
            node("ConstantOfShape", "shape", gives="w"),
            node("Cast", "image", gives="f", to=1),
            node("Conv", "f", "w", pads=[2**40] * 4),
            shape=[1, 8, 1, 1],
        ),
        "a decision takes over",
    ),
    "reads": (
        lambda: put(
            model(),
            node("ConstantOfShape", "shape", gives="y0"),
            *[node("ReduceSum", "y0", gives=f"y{n}") for n in range(1, 9_000)],
            shape=[10**4, 10**4],
        ),
        "a decision takes over",
    ),
    "computed shape": (
        lambda: put(
            model(),
            node("Cast", "motion", gives="i", to=7),
            node("ReduceMax", "i", gives="m"),
            node("Expand", "zero", "m"),
        ),
        "makes a shape of what is computed",
    ),
    "division": (
        lambda: put(
            model(), node("Cast", "motion", gives="i", to=7), node("Div", "i", "nought"), nought=[0, 0]
        ),
        "divides whole numbers by something else than constants above 0",
    ),
    "remainder": (
        lambda: put(model(), node("Cast", "motion", gives="i", to=7), node("Mod", "i", "i")),
        "divides whole numbers",
    ),
    "loop": (lambda: put(model(), node("Loop", "motion")), "the operator Loop, which a policy may not use"),
    "if": (lambda: put(model(), node("If", "motion")), "the operator If, which a policy may not use"),
    "tile": (
        lambda: put(model(), node("Tile", "motion", "n"), n=[1, 9]),
        "the operator Tile, which a policy may",
    ),
    "foreign": (
        lambda: put(model(), helper.make_node("Relu", ["motion"], ["x"], domain="com.evil")),
        "com.evil.Relu",
    ),
    "integers": (
        lambda: put(model(), node("Cast", "motion", gives="i", to=7), node("Gemm", "i", "i", transB=1)),
        "computes with whole numbers",
    ),
    "missing input": (lambda: put(model(), node("Min", "motion", "")), "its Min lacks an input"),
    "missing output": (
        lambda: put(model(), node("Relu", "motion", gives="")),
        "its Relu lacks an input or",
    ),
    "dimensions": (
        lambda: put(model(), node("Unsqueeze", "motion", "axes"), axes=list(range(1, 17))),
        "its Unsqueeze makes a value of more than 16 sizes",
    ),
    "late": (lambda: put(model(), node("Relu", "later")), "uses 'later' before it is computed"),
    "twice": (lambda: put(model(), node("Relu", "motion", gives="waypoint")), "computes 'waypoint' twice"),
    "double": (lambda: put(model(), node("Add", "motion", "d"), d=np.zeros(2)), "a constant has the type 11"),
}


def test_the_policy_that_all_bombs_are_made_of_drives() -> None:
    policy = OnnxPolicy(put(model(), node("Relu", "motion")).SerializeToString())
    images, motion = np.zeros((2, 8, 8, 4), np.uint8), np.zeros((2, 2), np.float32)
    assert policy.step(images, motion, {}).actions["behaviour"].tolist() == [[0.0], [0.0]]


@pytest.mark.parametrize("name", BOMBS)
def test_a_graph_that_would_not_end_well_is_one_line(name: str) -> None:
    make, said = BOMBS[name]
    with pytest.raises(InvalidPolicy, match=re.escape(said)) as caught:
        OnnxPolicy(make().SerializeToString())
    assert len(str(caught.value)) < 300
    assert "\n" not in str(caught.value)


def external(made: onnx.ModelProto) -> None:
    tensor = made.graph.initializer.add(name="w", data_type=TensorProto.FLOAT, dims=[4])
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")


def without_numbers(made: onnx.ModelProto) -> None:
    made.graph.initializer.add(name="w", data_type=TensorProto.FLOAT, dims=[2**40, 2**20])


def negative(made: onnx.ModelProto) -> None:
    made.graph.initializer.add(name="w", data_type=TensorProto.FLOAT, dims=[-1, -4], raw_data=bytes(16))


def sparse(made: onnx.ModelProto) -> None:
    made.graph.sparse_initializer.add().dims.append(2**50)


def function(made: onnx.ModelProto) -> None:
    made.functions.add(name="f", domain="", node=[node("Relu", "motion")])


def subgraph(made: onnx.ModelProto) -> None:
    made.graph.node[0].attribute.append(helper.make_attribute("body", made.graph))


def repeated(made: onnx.ModelProto) -> None:
    made.graph.node[0].attribute.extend([helper.make_attribute("value_float", 1.0)])


def many(made: onnx.ModelProto) -> None:
    made.graph.node.extend([node("Relu", "motion")] * 25_001)


def old(made: onnx.ModelProto) -> None:
    made.opset_import[0].version = 7


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (external, "the constant 'w' lies in another file; a policy is one file"),
        (without_numbers, "the constant 'w' does not have the"),
        (negative, "a value has the shape [-1, -4]"),
        (sparse, "its Graph has the field 15 of ONNX"),
        (function, "its Model has the field 25 of ONNX"),
        (subgraph, "its Attribute has the field 6 of ONNX"),
        (repeated, "its Constant has an attribute twice"),
        (many, "it has more than 100,000 parts"),
        (old, "it has version 7 of ONNX's operators; it should be 13 to 24"),
    ],
)
def test_a_part_that_no_policy_has_is_refused(change: Callable, said: str) -> None:
    made = model()
    change(made)
    with pytest.raises(InvalidPolicy, match=re.escape(said)):
        OnnxPolicy(made.SerializeToString())


@pytest.mark.parametrize("text", ["[" * 200_000, "9" * 5001, "nan", '{"schema_version": 1e400}'])
def test_a_description_that_no_parser_survives_is_one_line(text: str) -> None:
    made = model()
    made.metadata_props[0].value = text
    with pytest.raises(InvalidPolicy) as caught:
        OnnxPolicy(made.SerializeToString())
    assert "\n" not in str(caught.value)


def test_what_fails_only_when_it_runs_is_the_policys_fault() -> None:
    made = put(
        model(),
        node("Cast", "motion", gives="i", to=7),
        node("Gather", "table", "i"),
        table=np.ones(3, np.float32),
    )
    policy = OnnxPolicy(made.SerializeToString())
    images, motion = np.zeros((1, 8, 8, 4), np.uint8), np.full((1, 2), 99.0, np.float32)
    with pytest.raises(InvalidPolicy, match=r"^ONNX Runtime cannot run it \(.*indices element out of data"):
        policy.step(images, motion, {})


def test_what_takes_too_much_for_many_environments_alone_is_refused_then() -> None:
    made = put(model(), node("Transpose", "first", gives="t"), node("Mul", "first", "t"))
    policy = OnnxPolicy(made.SerializeToString())
    for batch, fits in ((100, True), (12_000, False)):
        images, motion = np.zeros((batch, 8, 8, 4), np.uint8), np.zeros((batch, 2), np.float32)
        if fits:
            policy.step(images, motion, {})
        else:
            with pytest.raises(InvalidPolicy, match="a decision takes over"):
                policy.step(images, motion, {})


def test_the_page_about_policies_lists_the_operators() -> None:
    page = (ROOT / "docs/reference/policy-artefact.md").read_text()
    listed = page.split("## Operators")[1].split("\n## ")[0]
    assert re.findall(r"`([A-Z]\w+)`", listed) == sorted(OPERATORS)


def test_committed_code_is_what_the_schema_generates(tmp_path: Path) -> None:
    pytest.importorskip("grpc_tools")
    driving = ROOT / "driving"
    subprocess.run([sys.executable, driving / "generate.py", tmp_path], check=True, timeout=120)
    for name in ("onnx_model_pb2.py", "onnx_model_pb2.pyi"):
        committed = Path(athrl_driving.__file__).parent / "policy" / "graph" / name
        assert committed.read_text() == (tmp_path / name).read_text(), "run driving/generate.py"
