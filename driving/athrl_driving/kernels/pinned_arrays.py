"""Tuples of arrays with a fixed address, so that passing them to a kernel costs nothing.

numba unpacks a tuple at every call: with nearly two hundred arrays that takes as long as the simulation
itself, and seconds of compilation. A pinned tuple is laid out in memory once as compiled code expects it, and
the kernel gets the address: a reference as made by `by_reference`.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numba import typeof
from numba.core import types
from numba.core.base import BaseContext
from numba.extending import NativeValue, unbox

from athrl_driving.kernels.by_reference import Reference


class Pinned:
    """A named tuple of arrays, numbers and such tuples, for compiled functions that take a reference to it.

    The arrays are shared with the caller, so the kernel sees later changes; the numbers are copied.
    """

    __slots__ = ("_memory", "_numba_type_", "address", "value")

    def __init__(self, value: tuple) -> None:
        self.value = value
        self._numba_type_ = Reference(typeof(value))
        self._memory = np.array(_words(value), dtype=np.uint64)
        self.address = self._memory.ctypes.data

    def __reduce__(self) -> tuple:
        """Copy the arrays and pin these: the address is that of this one's."""
        return Pinned, (self.value,)


def _words(value: Any) -> list[int]:
    """The 64-bit words of a value as compiled code lays it out."""
    if isinstance(value, tuple):
        return [word for field in value for word in _words(field)]
    if isinstance(value, np.ndarray):
        # No counted owner and no parent; then size, item size, address, shape and strides.
        extent = [0, 0, value.size, value.itemsize, value.ctypes.data]
        return extent + [each % 2**64 for each in (*value.shape, *value.strides)]
    if isinstance(value, float):
        return [ctypes.c_uint64.from_buffer(ctypes.c_double(value)).value]
    if isinstance(value, int) and not isinstance(value, bool):
        return [value % 2**64]
    raise TypeError(f"a {type(value).__name__} cannot be pinned: only arrays, numbers and tuples of them")


@unbox(Reference)
def _unbox_reference(reference: types.Type, pinned: Any, context: Any) -> NativeValue:
    """Take the address of a pinned tuple."""
    python, builder = context.pyapi, context.builder
    number = python.object_getattr_string(pinned, "address")
    address = python.long_as_ulonglong(number)
    python.decref(number)
    place: BaseContext = context.context
    return NativeValue(builder.inttoptr(address, place.get_value_type(reference)))
