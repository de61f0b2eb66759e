"""Tuples of arrays by reference: how a kernel passes its whole state to its parts at no cost.

numba passes a tuple of arrays by value, seven numbers an array: with a hundred arrays that is most of the
time of a call, and nearly all of the time of compiling one. `by_reference` puts the tuple on the stack once;
fields are read from there by name as from the tuple; inner tuples are references again.
"""

from typing import Any

from numba.core import cgutils, types
from numba.core.base import BaseContext
from numba.core.datamodel import DataModelManager, models, register_default
from numba.core.types.containers import BaseNamedTuple
from numba.core.typing.templates import AttributeTemplate, Signature
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic


class Reference(types.Type):
    """The numba type of a reference to a named tuple."""

    def __init__(self, target: Any) -> None:
        self.target = target
        super().__init__(name=f"Reference({target})")

    def field(self, name: str) -> Any:
        """Return the type of a field's value: a reference where that is a named tuple itself."""
        value = self.target.types[self.target.fields.index(name)]
        return Reference(value) if isinstance(value, BaseNamedTuple) else value


@register_default(Reference)
class _ReferenceModel(models.PrimitiveModel):
    """A pointer to the tuple's value."""

    def __init__(self, manager: DataModelManager, reference: Reference) -> None:
        pointer = manager.lookup(reference.target).get_value_type().as_pointer()
        super().__init__(manager, reference, pointer)


@infer_getattr
class _ReferenceAttribute(AttributeTemplate):
    key = Reference

    def generic_resolve(self, reference: Reference, name: str) -> types.Type | None:
        return reference.field(name) if name in reference.target.fields else None


@lower_getattr_generic(Reference)
def _read_field(context: BaseContext, builder: Any, reference: Reference, pointer: Any, name: str) -> Any:
    index = reference.target.fields.index(name)
    field = cgutils.gep_inbounds(builder, pointer, 0, index)
    # A tuple may hold another one, or a reference to another one.
    return field if isinstance(reference.target.types[index], BaseNamedTuple) else builder.load(field)


@intrinsic
def _referenced(typing_context: object, value: Any) -> tuple[Signature, object] | None:
    if isinstance(value, Reference):
        return value(value), lambda context, builder, signature, arguments: arguments[0]
    if not isinstance(value, BaseNamedTuple):
        return None

    def put_on_the_stack(
        context: BaseContext, builder: Any, signature: Signature, arguments: list[Any]
    ) -> Any:
        return cgutils.alloca_once_value(builder, arguments[0])

    return Reference(value)(value), put_on_the_stack


by_reference = _referenced
"""Return a reference to a named tuple, or a reference as it is.

It is valid within the calling function and is not counted: the caller has to own the arrays.
"""
