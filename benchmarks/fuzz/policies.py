"""Broken policies: bytes, the graph's nodes, constants and attributes, and the description."""

from __future__ import annotations

import random
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import onnx
import onnx.defs
import onnx.parser
from athrl_driving.policy import InvalidPolicy, OnnxPolicy
from athrl_spaces import WAYPOINT, LevelDescription, Limits, Observation, PolicyDescription, action_kind
from onnx import AttributeProto, ModelProto, helper, numpy_helper

from benchmarks.fuzz import mutations
from benchmarks.fuzz.frame import Parser

_SIZE, _STATE = 8, 4
_BATCHES = (1, 3)

# A small policy of the kinds of operators that planners are exported with; its weights are `_weights`.
_GRAPH = """
<ir_version: 8, opset_import: ["" : 17]>
policy (uint8[N,8,8,4] image, float[N,2] motion, float[N,4] trajectory_state, float[N,2] trajectory_noise,
        float[N,2] forced_trajectory) => (float[N,2] trajectory, float[N,4] next_trajectory_state)
{
    planes = Transpose <perm: ints = [0, 3, 1, 2]> (image)
    pixels = Cast <to: int = 1> (planes)
    seen = Conv <dilations: ints = [1, 1], group: int = 1, kernel_shape: ints = [3, 3],
        pads: ints = [1, 1, 1, 1], strides: ints = [2, 2]> (pixels, kernel, kernel_bias)
    lit = Relu (seen)
    sizes = Shape (lit)
    first = Constant <value: tensor = int64[1] {0}> ()
    batch = Gather <axis: int = 0> (sizes, first)
    rest = Constant <value: tensor = int64[1] {-1}> ()
    flat_sizes = Concat <axis: int = 0> (batch, rest)
    flat = Reshape (lit, flat_sizes)
    normal = LayerNormalization <axis: int = -1> (flat, scale, shift)
    joined = Concat <axis: int = 1> (normal, motion)
    hidden = Gemm <alpha: float = 1.0, beta: float = 1.0, transB: int = 1> (joined, dense, dense_bias)
    parts = Constant <value: tensor = int64[2] {2, 2}> ()
    output, cell = Split <axis: int = 1> (trajectory_state, parts)
    gate = Sigmoid (output)
    kept = Mul (gate, cell)
    fresh = Tanh (hidden)
    next_cell = Add (kept, fresh)
    next_trajectory_state = Concat <axis: int = 1> (next_cell, cell)
    half = Constant <value: tensor = float[2] {3.975, 0.5235}> ()
    middle = Constant <value: tensor = float[2] {3.975, 0.0}> ()
    bounded = Tanh (next_cell)
    spread = Mul (bounded, half)
    decided = Add (spread, middle)
    loud = Add (decided, trajectory_noise)
    lowest = Sub (middle, half)
    highest = Add (middle, half)
    at_least = Max (loud, lowest)
    within = Min (at_least, highest)
    free = IsNaN (forced_trajectory)
    trajectory = Where (free, within, forced_trajectory)
}
"""
_ODD_NUMBERS = [
    0,
    1,
    -1,
    2,
    3,
    8,
    16,
    63,
    255,
    2**15,
    2**20,
    2**31 - 1,
    2**31,
    2**40,
    2**62,
    2**63 - 1,
    -(2**63),
]
_OPERATORS = sorted({schema.name for schema in onnx.defs.get_all_schemas() if not schema.domain})


def policy(folder: Path) -> Parser:
    """Return the parser of policies, which also decides with what it has opened."""
    proper = _model()

    def decide(content: bytes) -> None:
        opened = OnnxPolicy(content)
        seen = opened.description.observation
        for batch in _BATCHES:
            images = np.zeros((batch, *seen.image_shape), np.uint8)
            motion = np.zeros((batch, seen.motion_size), np.float32)
            opened.step(images, motion, opened.initial_states(batch))

    def broken(chance: random.Random) -> bytes:
        if chance.random() < 0.3:
            return chance.choice(mutations.BYTES)(chance, proper)
        model = ModelProto.FromString(proper)
        for _ in range(chance.choice([1, 1, 1, 2, 4])):
            with suppress(IndexError, RecursionError, ValueError):  # that is gone or broken already
                chance.choice(_CHANGES)(chance, model)
        return bytes(model.SerializeToString())

    return Parser([proper], broken, decide, (InvalidPolicy,))


def _model() -> bytes:
    model = onnx.parser.parse_model(_GRAPH)
    random_numbers = np.random.default_rng(0)
    for name, shape in {
        "kernel": (4, 4, 3, 3), "kernel_bias": (4,), "scale": (64,), "shift": (64,), "dense": (2, 66),
        "dense_bias": (2,),
    }.items():  # fmt: skip
        weights = random_numbers.standard_normal(shape).astype(np.float32)
        model.graph.initializer.append(numpy_helper.from_array(weights, name))
    limits = Limits()
    level = LevelDescription("trajectory", action_kind(WAYPOINT).describe(limits), _STATE)
    description = PolicyDescription("fuzzed", WAYPOINT, limits, Observation(_SIZE), (level,))
    helper.set_model_props(model, {"athrl": description.to_json()})
    return bytes(model.SerializeToString())


def _change_operator(chance: random.Random, model: ModelProto) -> None:
    chance.choice(model.graph.node).op_type = chance.choice(_OPERATORS)


def _change_inputs(chance: random.Random, model: ModelProto) -> None:
    names = [name for node in model.graph.node for name in [*node.input, *node.output]]
    node = chance.choice(model.graph.node)
    match chance.randrange(4):
        case 0 if node.input:
            node.input[chance.randrange(len(node.input))] = chance.choice([*names, "", "nowhere"])
        case 1 if node.output:
            node.output[chance.randrange(len(node.output))] = chance.choice([*names, ""])
        case 2 if node.input:
            del node.input[chance.randrange(len(node.input))]
        case _:
            chance.choice([node.input, node.output]).append(chance.choice(names))


def _change_attribute(chance: random.Random, model: ModelProto) -> None:
    attributes = [attribute for node in model.graph.node for attribute in node.attribute]
    attribute = chance.choice(attributes)
    match chance.randrange(4):
        case 0:
            attribute.type = chance.choice([0, 1, 2, 3, 4, 5, 6, 7, 10])
        case 1 if attribute.type == AttributeProto.TENSOR:
            _change_tensor(chance, attribute.t)
        case 2:
            attribute.name = chance.choice([other.name for other in attributes])
        case _ if attribute.type == AttributeProto.INTS:
            numbers = list(attribute.ints) or [0]
            numbers[chance.randrange(len(numbers))] = chance.choice(_ODD_NUMBERS)
            attribute.ints[:] = numbers * chance.choice([1, 1, 1, 3])
        case _:
            attribute.i = chance.choice(_ODD_NUMBERS)
            attribute.f = chance.choice([0.0, 1e38, float("inf"), float("nan"), -1.0])


def _change_tensor(chance: random.Random, tensor: onnx.TensorProto) -> None:
    match chance.randrange(6):
        case 0:
            tensor.data_type = chance.randrange(20)
        case 1:
            tensor.raw_data = mutations.changed_bytes(chance, tensor.raw_data)
        case 2:
            tensor.data_location = onnx.TensorProto.EXTERNAL
            tensor.external_data.add(key="location", value=chance.choice(["/etc/passwd", "x", "../x", ""]))
        case 3:
            numbers = np.array(
                [chance.choice(_ODD_NUMBERS) for _ in range(chance.choice([1, 2, 5]))], np.int64
            )
            tensor.CopyFrom(numpy_helper.from_array(numbers, tensor.name))
        case 4 if tensor.dims:
            del tensor.dims[chance.randrange(len(tensor.dims))]
        case _:
            tensor.dims.append(chance.choice(_ODD_NUMBERS))


def _change_constant(chance: random.Random, model: ModelProto) -> None:
    _change_tensor(chance, chance.choice(model.graph.initializer))


def _change_order(chance: random.Random, model: ModelProto) -> None:
    nodes = list(model.graph.node)
    place = chance.randrange(len(nodes))
    match chance.randrange(3):
        case 0:
            del nodes[place]
        case 1:
            nodes.insert(chance.randrange(len(nodes)), nodes[place])
        case _:
            other = chance.randrange(len(nodes))
            nodes[place], nodes[other] = nodes[other], nodes[place]
    nodes = [onnx.NodeProto.FromString(node.SerializeToString()) for node in nodes]
    del model.graph.node[:]
    model.graph.node.extend(nodes)


def _change_interface(chance: random.Random, model: ModelProto) -> None:
    each = chance.choice([*model.graph.input, *model.graph.output])
    match chance.randrange(4):
        case 0:
            each.type.tensor_type.elem_type = chance.randrange(20)
        case 1:
            chance.choice(each.type.tensor_type.shape.dim).dim_value = chance.choice(_ODD_NUMBERS)
        case 2:
            each.name = chance.choice(["", "image", "trajectory", "x"])
        case _:
            del model.graph.output[:]


def _change_description(chance: random.Random, model: ModelProto) -> None:
    for each in model.metadata_props:
        changed = chance.choice([mutations.changed_json, mutations.changed_numbers, mutations.nested])
        each.value = changed(chance, each.value.encode()).decode(errors="replace")


def _add_growth(chance: random.Random, model: ModelProto) -> None:
    """Put in front what doubles a value again and again."""
    kind = chance.choice(["Concat", "MatMul", "Expand", "Gather"])
    name = chance.choice(["motion", "trajectory_state"])
    attributes = {"axis": 1} if kind == "Concat" else {}
    names = [name, *(f"grown{number}" for number in range(chance.choice([3, 30, 60])))]
    nodes = [helper.make_node(kind, [a, a], [b], **attributes) for a, b in pairwise(names)]
    rest = [onnx.NodeProto.FromString(node.SerializeToString()) for node in model.graph.node]
    del model.graph.node[:]
    model.graph.node.extend([*nodes, *rest])


_CHANGES: list[Callable[[random.Random, ModelProto], None]] = [
    _change_operator, _change_inputs, _change_inputs, _change_attribute, _change_attribute, _change_constant,
    _change_order, _change_interface, _change_description, _change_description, _add_growth,
]  # fmt: skip
