"""The size of a value of a graph, and its numbers where the sizes of other values may depend on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from athrl_driving.policy.graph.onnx_model_pb2 import Attribute, Node, Tensor

MOST_DIMENSIONS = 16
MOST_KNOWN = 1024
"""Whole numbers of a value that are followed, since they may be another value's shape."""

DTYPES: dict[int, np.dtype] = {
    1: np.dtype("<f4"),
    2: np.dtype("u1"),
    6: np.dtype("<i4"),
    7: np.dtype("<i8"),
    9: np.dtype("?"),
}
"""ONNX's numbers of the types that a value may have."""

FLOAT, UINT8, INT32, INT64, BOOL = DTYPES

_FLOAT, _INT, _TENSOR, _FLOATS, _INTS = 1, 2, 4, 6, 7


@dataclass(frozen=True)
class Value:
    """A value of a graph.

    Attributes:
        shape: its sizes.
        dtype: ONNX's number of its type.
        known: its numbers, if they do not depend on the inputs, are whole, and few.
    """

    shape: tuple[int, ...]
    dtype: int = FLOAT
    known: NDArray | None = None

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return math.prod(self.shape)

    @property
    def bytes(self) -> int:
        """The memory that it takes."""
        return self.size * DTYPES[self.dtype].itemsize


class Outcome(NamedTuple):
    """What a node gives and takes.

    Attributes:
        outputs: its values.
        products: multiplications, beside one step for each number that is read or written.
        scratch: numbers that it keeps while it runs.
    """

    outputs: list[Value]
    products: int = 0
    scratch: int = 0


class NodeView:
    """A node with its inputs' values; a missing or odd part raises ValueError, which names the node."""

    def __init__(self, node: Node, inputs: list[Value | None]) -> None:
        self.kind: str = node.op_type
        self.outputs = len(node.output)
        self.values = inputs
        self._attributes = {attribute.name: attribute for attribute in node.attribute}
        if len(self._attributes) < len(node.attribute):
            raise self.error("has an attribute twice")

    def error(self, text: str) -> ValueError:
        """An error at this node."""
        return ValueError(f"its {self.kind} {text}")

    def value(self, place: int) -> Value:
        """An input that has to be there."""
        value = self.optional(place)
        if value is None:
            raise self.error(f"has no input {place}")
        return value

    def optional(self, place: int) -> Value | None:
        """An input, or None."""
        return self.values[place] if place < len(self.values) else None

    def shape(self, place: int = 0) -> tuple[int, ...]:
        """The shape of an input."""
        return self.value(place).shape

    def numbers(self, place: int) -> list[int] | None:
        """The numbers of an input that determines shapes; None if it is missing."""
        value = self.optional(place)
        if value is None:
            return None
        if value.known is None or value.dtype not in (INT32, INT64):
            raise self.error("makes a shape of what is computed; it should follow from the batch alone")
        return [int(number) for number in value.known.ravel()]

    def whole(self, name: str, default: int) -> int:
        """An attribute that is a whole number."""
        attribute = self._attribute(name, _INT)
        return default if attribute is None else int(attribute.i)

    def wholes(self, name: str) -> list[int] | None:
        """An attribute that is a list of whole numbers; None if it is missing."""
        attribute = self._attribute(name, _INTS)
        return None if attribute is None else [int(number) for number in attribute.ints]

    def floats(self, name: str) -> int | None:
        """How many numbers an attribute that is a list of them has; None if it is missing."""
        attribute = self._attribute(name, _FLOATS)
        return None if attribute is None else len(attribute.floats)

    def has_float(self, name: str) -> bool:
        """Whether there is such an attribute, which has to be a number."""
        return self._attribute(name, _FLOAT) is not None

    def tensor(self, name: str) -> Value | None:
        """An attribute that is a constant; None if it is missing."""
        attribute = self._attribute(name, _TENSOR)
        return None if attribute is None else constant(attribute.t)

    def has(self, name: str) -> bool:
        """Whether there is such an attribute."""
        return name in self._attributes

    def axis(self, axis: int, rank: int) -> int:
        """An axis from 0; raises ValueError if a value with so many axes does not have it."""
        if not -rank <= axis < rank:
            raise self.error(f"has the axis {axis} of {rank}")
        return axis % rank

    def broadcast(self, shapes: list[tuple[int, ...]]) -> tuple[int, ...]:
        """The shape that shapes broadcast to; raises ValueError if they do not."""
        try:
            return tuple(int(size) for size in np.broadcast_shapes(*shapes))
        except ValueError:
            told = " and ".join(str(list(shape)) for shape in shapes)
            raise self.error(f"combines the shapes {told}"[:150]) from None

    def _attribute(self, name: str, kind: int) -> Attribute | None:
        attribute = self._attributes.get(name)
        if attribute is not None and attribute.type != kind:
            raise self.error(f"has an attribute {name[:40]!r} of another type than it should have")
        return attribute


def constant(tensor: Tensor) -> Value:
    """A constant; raises ValueError if it does not have the numbers that its shape says."""
    shape = checked_shape(tensor.dims)
    dtype = DTYPES.get(tensor.data_type)
    if dtype is None:
        raise ValueError(f"a constant has the type {tensor.data_type}; it should be one of {sorted(DTYPES)}")
    if tensor.data_location or tensor.external_data:
        raise ValueError(
            f"the constant {tensor.name[:60]!r} lies in another file; a policy is one file with its weights"
        )
    size = math.prod(shape)
    fields: Sequence[float] = tensor.int32_data
    if tensor.data_type in (FLOAT, INT64):
        fields = tensor.float_data if tensor.data_type == FLOAT else tensor.int64_data
    if not (len(tensor.raw_data) == size * dtype.itemsize or (not tensor.raw_data and len(fields) == size)):
        raise ValueError(f"the constant {tensor.name[:60]!r} does not have the {size:,} numbers of its shape")
    known = None
    if tensor.data_type != FLOAT and size <= MOST_KNOWN:
        numbers = np.frombuffer(tensor.raw_data, dtype) if tensor.raw_data else np.array(fields).astype(dtype)
        known = numbers.reshape(shape)
    return Value(shape, tensor.data_type, known)


def checked_shape(sizes: object) -> tuple[int, ...]:
    """A shape; raises ValueError if a size is negative or there are too many."""
    shape = tuple(int(size) for size in sizes)  # type: ignore[attr-defined]
    if len(shape) > MOST_DIMENSIONS or any(size < 0 for size in shape):
        raise ValueError(f"a value has the shape {list(shape)[:20]}; it should have at most 16 sizes from 0")
    return shape
