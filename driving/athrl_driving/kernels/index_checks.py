"""A debug build of all kernels that checks every index: `ATHRL_CHECK_INDICES=1`.

Compiled code reads and writes wherever an index points. numba can check that an index is less than the size
of its axis, but a negative one counts from the end, as in Python, and a slice is cut to what there is. A
kernel's indices come from tables where -1 means *none*: there, both are mistakes that hide. So the checked
build refuses them too, and says where, which index, and how large the axis is.

Kernels that count from the end on purpose write `size - 1`.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from numba.core import types
from numba.core.cgutils import if_unlikely, unpack_tuple
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.lowering import Lower
from numba.core.runtime.context import NRTContext
from numba.core.typed_passes import BaseNativeLowering, NativeLowering
from numba.core.types.containers import BaseTuple
from numba.core.types.misc import SliceType
from numba.np.arrayobj import make_array

CHECKS_INDICES = os.environ.get("ATHRL_CHECK_INDICES", "") not in ("", "0")
"""Whether the kernels of this process check their indices; it is told by the environment at its start."""


class KernelIndexError(IndexError):
    """A kernel's index lies outside its array: file and line, axis, index, and the size of the axis."""

    def __str__(self) -> str:
        place, axis, index, size = self.args
        return f"{place}: axis {axis} has {size} places, it is indexed with {index}"


def compiler_options() -> dict[str, Any]:
    """Return what `numba.njit` needs besides to make the build that checks its indices."""
    return {"pipeline_class": _CheckedCompiler, "boundscheck": True}


class _CheckedLower(Lower):
    """Writes a check before every access to an array by a number, a slice, or a tuple of them."""

    def pre_lower(self) -> None:
        super().pre_lower()
        # The numbers of an error are kept in memory of numba's runtime, in functions too that count nothing.
        self.context.nrt = NRTContext(self.context, True)

    def lower_getitem(self, resty: Any, expr: Any, value: Any, index: Any, signature: Any) -> Any:
        self._check(value, index, signature)
        return super().lower_getitem(resty, expr, value, index, signature)

    def lower_setitem(self, target_var: Any, index_var: Any, value_var: Any, signature: Any) -> Any:
        self._check(target_var, index_var, signature)
        return super().lower_setitem(target_var, index_var, value_var, signature)

    def _check(self, array: Any, index: Any, signature: Any) -> None:
        """Check an index of an array; both are variables of numba's intermediate code."""
        array_type, index_type = self.typeof(array.name), signature.args[1]
        if not isinstance(array_type, types.Array):
            return
        shape = make_array(array_type)(self.context, self.builder, self.loadvar(array.name)).shape
        value = self.context.cast(self.builder, self.loadvar(index.name), self.typeof(index.name), index_type)
        if isinstance(index_type, BaseTuple):
            kinds, values = tuple(index_type), unpack_tuple(self.builder, value)
        else:
            kinds, values = (index_type,), [value]
        if types.ellipsis in kinds:
            return  # numba's own check has to do
        for axis, (kind, each, size) in enumerate(
            zip(kinds, values, unpack_tuple(self.builder, shape), strict=False)
        ):
            self._check_axis(kind, each, axis, size)

    def _check_axis(self, kind: Any, value: Any, axis: int, size: Any) -> None:
        builder = self.builder
        if isinstance(kind, types.Integer):
            wide = types.uintp if kind in types.unsigned_domain else types.intp
            number = self.context.cast(builder, value, kind, wide)
            # As an unsigned number, a negative one is larger than any size.
            self._refuse(builder.icmp_unsigned(">=", number, size), axis, number, size)
        elif isinstance(kind, SliceType):
            limits = self.context.make_helper(builder, kind, value)
            for number in (limits.start, limits.stop):
                outside = builder.icmp_unsigned(">", number, size)
                # What a slice like `[2:]` does not give is the largest number.
                given = builder.icmp_signed("!=", number, number.type(types.intp.maxval))
                self._refuse(builder.and_(outside, given), axis, number, size)

    def _refuse(self, outside: Any, axis: int, number: Any, size: Any) -> None:
        """Raise an error where `outside` is true."""
        place = f"{'/'.join(Path(self.loc.filename).parts[-2:])}:{self.loc.line}"
        with if_unlikely(self.builder, outside):
            self.call_conv.return_dynamic_user_exc(
                self.builder,
                KernelIndexError,
                (place, axis, number, size),
                (None, None, types.intp, types.intp),
                loc=self.loc,
                func_name=self.func_ir.func_id.func_name,
            )


@register_pass(mutates_CFG=True, analysis_only=False)
class _CheckedLowering(BaseNativeLowering):
    """Makes machine code with checks."""

    _name = "checked_lowering"

    @property
    def lowering_class(self) -> type[Lower]:
        return _CheckedLower


class _CheckedCompiler(CompilerBase):
    """numba's compiler of kernels, which makes machine code with checks."""

    def define_pipelines(self) -> list[PassManager]:
        usual = DefaultPassBuilder.define_nopython_pipeline(self.state)
        checked = PassManager("checked")
        for each, description in usual.passes:
            checked.add_pass(_CheckedLowering if each is NativeLowering else each, description)
        checked.finalize()
        return [checked]
