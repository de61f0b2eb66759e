"""The operators that a policy may use, and for each how large its outputs are and how much work they take.

There are none with a graph inside (Loop, Scan, If), none whose output is as large as a computed number says,
and none that reads files. Rules follow https://onnx.ai/onnx/operators.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from athrl_driving.policy.graph import products
from athrl_driving.policy.graph.values import (
    BOOL,
    DTYPES,
    FLOAT,
    INT64,
    MOST_KNOWN,
    NodeView,
    Outcome,
    Value,
    checked_shape,
)

MANY = 10_000
"""Inputs of an operator that takes any number of them."""


class Operator(NamedTuple):
    """An operator that a policy may use.

    Attributes:
        rule: gives the outputs and work of a node.
        required: inputs that have to be there; ONNX Runtime ends the process where one is missing.
        most: inputs, with those that may be missing.
    """

    rule: Callable[[NodeView], Outcome]
    required: int
    most: int


_WHOLE_NUMBERS: dict[str, Callable] = {
    "Add": np.add,
    "Div": lambda a, b: a // b + ((a % b != 0) & (a < 0)),  # towards 0; the divisor is above 0
    "Sub": np.subtract,
    "Mul": np.multiply,
    "Min": np.minimum,
    "Mod": np.mod,
    "Max": np.maximum,
    "Equal": np.equal,
    "Where": np.where,
}
"""What is followed with numbers that may be shapes; overflows wrap as they do when it runs."""

_TESTS = frozenset(
    ["And", "Equal", "Greater", "GreaterOrEqual", "IsInf", "IsNaN", "Less", "LessOrEqual", "Not", "Or", "Xor"]
)
"""Operators whose output is true or false."""


def _elementwise(node: NodeView) -> Outcome:
    """Inputs of shapes that broadcast to each other."""
    given = [value for value in node.values if value is not None]
    shape = node.broadcast([value.shape for value in given])
    dtype = BOOL if node.kind in _TESTS else node.value(1 if node.kind == "Where" else 0).dtype
    if node.kind in ("Div", "Mod") and dtype != FLOAT:
        _refuse_division_by_zero(node)
    compute = None if node.whole("fmod", 0) else _WHOLE_NUMBERS.get(node.kind)
    numbers = [value.known for value in given if value.known is not None]
    known = None
    if compute is not None and math.prod(shape) <= MOST_KNOWN and len(numbers) == len(given):
        with np.errstate(over="ignore"):
            known = np.asarray(compute(*numbers))
    return Outcome([Value(shape, dtype, known)])


def _refuse_division_by_zero(node: NodeView) -> None:
    """Dividing a whole number by 0, or the lowest one by -1, ends the process."""
    divisor = node.value(1).known
    if divisor is None or (divisor < 1).any():
        raise node.error("divides whole numbers by something else than constants above 0")


def _same(node: NodeView) -> Outcome:
    """An output like the first input."""
    value = node.value(0)
    return Outcome([Value(value.shape, BOOL if node.kind in _TESTS else value.dtype)])


def _copy(node: NodeView) -> Outcome:
    return Outcome([node.value(0)])


def _cast(node: NodeView) -> Outcome:
    value, dtype = node.value(0), node.whole("to", 0)
    if dtype not in DTYPES:
        raise node.error(f"makes the type {dtype}; it should be one of {sorted(DTYPES)}")
    known = None if value.known is None or dtype == FLOAT else value.known.astype(DTYPES[dtype])
    return Outcome([Value(value.shape, dtype, known)])


def _constant(node: NodeView) -> Outcome:
    if node.has_float("value_float"):
        return Outcome([Value(())])
    count = node.floats("value_floats")
    if count is not None:
        return Outcome([Value((count,))])
    if node.has("value_int"):
        return Outcome([Value((), INT64, np.array(node.whole("value_int", 0), np.int64))])
    numbers = node.wholes("value_ints")
    if numbers is not None:
        known = np.array(numbers, np.int64) if len(numbers) <= MOST_KNOWN else None
        return Outcome([Value((len(numbers),), INT64, known)])
    value = node.tensor("value")
    if value is None:
        raise node.error("has no value")
    return Outcome([value])


def _filled(node: NodeView) -> Outcome:
    shape, value = checked_shape(node.numbers(0) or ()), node.tensor("value")
    if value is None:
        return Outcome([Value(shape)])
    known = None
    if value.known is not None and value.size == 1 and math.prod(shape) <= MOST_KNOWN:
        known = np.full(shape, value.known.ravel()[0], value.known.dtype)
    return Outcome([Value(shape, value.dtype, known)])


def _shape_of(node: NodeView) -> Outcome:
    sizes = node.shape()
    sizes = sizes[node.whole("start", 0) : node.whole("end", len(sizes))]
    return Outcome([Value((len(sizes),), INT64, np.array(sizes, np.int64))])


def _gather(node: NodeView) -> Outcome:
    data, indices = node.value(0), node.value(1)
    axis = node.axis(node.whole("axis", 0), len(data.shape))
    shape = (*data.shape[:axis], *indices.shape, *data.shape[axis + 1 :])
    known = None
    if data.known is not None and indices.known is not None and math.prod(shape) <= MOST_KNOWN:
        known = np.take(data.known, indices.known, axis)
    return Outcome([Value(shape, data.dtype, known)])


def _unsqueeze(node: NodeView) -> Outcome:
    data, axes = node.value(0), node.numbers(1) or []
    rank = len(data.shape) + len(axes)
    places = {node.axis(axis, rank) for axis in axes}
    if len(places) < len(axes):
        raise node.error("inserts an axis twice")
    rest = iter(data.shape)
    shape = tuple(1 if place in places else next(rest) for place in range(rank))
    return Outcome([_reshaped(data, shape)])


def _squeeze(node: NodeView) -> Outcome:
    data, axes = node.value(0), node.numbers(1)
    rank = len(data.shape)
    ones = {place for place, size in enumerate(data.shape) if size == 1}
    places = ones if axes is None else {node.axis(axis, rank) for axis in axes}
    if not places <= ones:
        raise node.error(f"removes an axis of {list(data.shape)} that is not 1")
    return Outcome([_reshaped(data, tuple(size for n, size in enumerate(data.shape) if n not in places))])


def _reshape(node: NodeView) -> Outcome:
    data, sizes = node.value(0), node.numbers(1) or []
    if not node.whole("allowzero", 0):
        sizes = [data.shape[n] if size == 0 and n < len(data.shape) else size for n, size in enumerate(sizes)]
    if sizes.count(-1) == 1:
        rest = math.prod(size for size in sizes if size != -1)
        sizes = [data.size // rest if size == -1 and rest > 0 else size for size in sizes]
    shape = checked_shape(sizes)
    if math.prod(shape) != data.size:
        raise node.error(f"makes {list(shape)} of {list(data.shape)}")
    return Outcome([_reshaped(data, shape)])


def _reshaped(data: Value, shape: tuple[int, ...]) -> Value:
    return Value(shape, data.dtype, None if data.known is None else data.known.reshape(shape))


def _flatten(node: NodeView) -> Outcome:
    shape = node.shape()
    axis = node.whole("axis", 1)
    axis = axis if axis == len(shape) else node.axis(axis, len(shape))
    return Outcome([_reshaped(node.value(0), (math.prod(shape[:axis]), math.prod(shape[axis:])))])


def _transpose(node: NodeView) -> Outcome:
    shape = node.shape()
    order = node.wholes("perm") or list(range(len(shape)))[::-1]
    if sorted(order) != list(range(len(shape))):
        raise node.error(f"has the order {order[:20]} of {len(shape)} axes")
    return Outcome([Value(tuple(shape[axis] for axis in order), node.value(0).dtype)])


def _concat(node: NodeView) -> Outcome:
    values = [node.value(place) for place in range(len(node.values))]
    first = node.shape()
    axis = node.axis(node.whole("axis", 0), len(first))
    rests = {(*value.shape[:axis], *value.shape[axis + 1 :]) for value in values}
    if len(rests) > 1 or any(len(value.shape) != len(first) for value in values):
        raise node.error("joins shapes that differ")
    shape = (*first[:axis], sum(value.shape[axis] for value in values), *first[axis + 1 :])
    known = [value.known for value in values if value.known is not None]
    joined = None
    if math.prod(shape) <= MOST_KNOWN and len(known) == len(values):
        joined = np.concatenate(known, axis)
    return Outcome([Value(shape, values[0].dtype, joined)])


def _split(node: NodeView) -> Outcome:
    shape = node.shape()
    axis = node.axis(node.whole("axis", 0), len(shape))
    sizes = node.numbers(1)
    if sizes is None:
        part = -(-shape[axis] // node.outputs)
        sizes = [min(part, max(0, shape[axis] - part * n)) for n in range(node.outputs)]
    if len(sizes) != node.outputs or sum(sizes) != shape[axis]:
        raise node.error(f"makes parts {sizes[:20]} of {shape[axis]}")
    dtype = node.value(0).dtype
    return Outcome([Value(checked_shape((*shape[:axis], size, *shape[axis + 1 :])), dtype) for size in sizes])


def _slice(node: NodeView) -> Outcome:
    data, starts, ends = node.value(0), node.numbers(1) or [], node.numbers(2) or []
    axes, steps = node.numbers(3) or list(range(len(starts))), node.numbers(4) or [1] * len(starts)
    if not len(starts) == len(ends) == len(axes) == len(steps) or 0 in steps:
        raise node.error("has starts, ends, axes and steps that do not fit")
    cuts = [slice(None)] * len(data.shape)
    for start, end, axis, step in zip(starts, ends, axes, steps, strict=True):
        cuts[node.axis(axis, len(cuts))] = slice(start, _end(end, step), step)
    shape = tuple(len(range(*cut.indices(size))) for cut, size in zip(cuts, data.shape, strict=True))
    return Outcome([Value(shape, data.dtype, None if data.known is None else data.known[tuple(cuts)])])


def _end(end: int, step: int) -> int | None:
    """ONNX writes an end before the first entry as a very low number."""
    return None if step < 0 and end <= -(2**31) + 1 else end


def _expand(node: NodeView) -> Outcome:
    sizes = checked_shape(node.numbers(1) or ())
    return Outcome([Value(node.broadcast([node.shape(), sizes]), node.value(0).dtype)])


def _one_hot(node: NodeView) -> Outcome:
    indices, depth = node.shape(0), node.numbers(1)
    if depth is None or len(depth) != 1:
        raise node.error("has no depth")
    axis = node.axis(node.whole("axis", -1), len(indices) + 1)
    shape = checked_shape((*indices[:axis], depth[0], *indices[axis:]))
    return Outcome([Value(shape, node.value(2).dtype)])


def _reduce(node: NodeView) -> Outcome:
    shape = node.shape()
    axes = node.wholes("axes") if node.has("axes") else node.numbers(1)
    if axes is None or not axes:
        if node.whole("noop_with_empty_axes", 0):
            return Outcome([Value(shape, node.value(0).dtype)])
        axes = list(range(len(shape)))
    return Outcome(
        [Value(_without(node, {node.axis(axis, len(shape)) for axis in axes}), node.value(0).dtype)]
    )


def _arg(node: NodeView) -> Outcome:
    return Outcome([Value(_without(node, {node.axis(node.whole("axis", 0), len(node.shape()))}), INT64)])


def _without(node: NodeView, axes: set[int]) -> tuple[int, ...]:
    """The shape without axes, or with size 1 there."""
    kept, sizes = node.whole("keepdims", 1), enumerate(node.shape())
    return tuple(1 if n in axes else size for n, size in sizes if kept or n not in axes)


def _table(*rows: tuple[Callable[[NodeView], Outcome], int, int, str]) -> dict[str, Operator]:
    return {
        name: Operator(rule, required, most) for rule, required, most, names in rows for name in names.split()
    }


OPERATORS = _table(
    (
        _elementwise,
        2,
        2,
        "Add And Div Equal Greater GreaterOrEqual Less LessOrEqual Mod Mul Or PRelu Pow Sub Xor",
    ),
    (_elementwise, 1, MANY, "Max Mean Min Sum"),
    (_elementwise, 1, 3, "Clip"),
    (_elementwise, 3, 3, "Where"),
    (_same, 1, 1, "Abs Celu Ceil Cos Elu Erf Exp Floor Gelu HardSigmoid HardSwish IsInf IsNaN LeakyRelu Log"),
    (_same, 1, 1, "LogSoftmax Mish Neg Not Reciprocal Relu Round Selu Sigmoid Sign Sin Softmax Softplus"),
    (_same, 1, 1, "Softsign Sqrt Tanh"),
    (_same, 2, 3, "LayerNormalization"),
    (_same, 3, 3, "InstanceNormalization"),
    (_same, 5, 5, "BatchNormalization"),
    (_reduce, 1, 2, "ReduceL1 ReduceL2 ReduceMax ReduceMean ReduceMin ReduceSum ReduceSumSquare"),
    (_arg, 1, 1, "ArgMax ArgMin"),
    (_cast, 1, 1, "Cast"),
    (_concat, 1, MANY, "Concat"),
    (_constant, 0, 0, "Constant"),
    (_copy, 1, 1, "Identity"),
    (_expand, 2, 2, "Expand"),
    (_filled, 1, 1, "ConstantOfShape"),
    (_flatten, 1, 1, "Flatten"),
    (_gather, 2, 2, "Gather"),
    (_one_hot, 3, 3, "OneHot"),
    (_reshape, 2, 2, "Reshape"),
    (_shape_of, 1, 1, "Shape"),
    (_slice, 3, 5, "Slice"),
    (_split, 1, 2, "Split"),
    (_squeeze, 1, 2, "Squeeze"),
    (_transpose, 1, 1, "Transpose"),
    (_unsqueeze, 2, 2, "Unsqueeze"),
    (products.conv, 2, 3, "Conv"),
    (products.gemm, 2, 3, "Gemm"),
    (products.global_pool, 1, 1, "GlobalAveragePool GlobalMaxPool"),
    (products.matmul, 2, 2, "MatMul"),
    (products.pool, 1, 1, "AveragePool MaxPool"),
)
"""By name in ONNX's own domain."""
