"""Views of one environment's state in that of many: the same memory without the environment axis."""

from collections.abc import Callable, Collection
from typing import Any, TypeVar

from athrl_driving.kernels.compilation import inlined

Arrays = TypeVar("Arrays")


def view_maker(
    structure: type[Arrays], numbers: Collection[str] = (), shared: Collection[str] = ()
) -> Callable[[Arrays, int], Arrays]:
    """Return a compiled function (arrays, environment) -> the view of that environment.

    It is generated as source code, because numba cannot loop over the fields of a tuple.

    Args:
        structure: named tuple of arrays [E, ...].
        numbers: fields with a single number per environment; in a view they are arrays [1].
        shared: fields that all environments share.
    """
    fields: tuple[str, ...] = structure._fields  # type: ignore[attr-defined]
    unknown = ({*numbers} | {*shared}) - {*fields}
    if unknown:
        raise ValueError(f"{structure.__name__} has no field {sorted(unknown)[0]!r}")

    def view(field: str) -> str:
        if field in shared:
            return f"arrays.{field}"
        return f"arrays.{field}[e : e + 1]" if field in numbers else f"arrays.{field}[e]"

    source = f"def environment_view(arrays, e):\n    return structure({', '.join(map(view, fields))})\n"
    names: dict[str, Any] = {"structure": structure, "__name__": __name__}
    exec(source, names)
    return inlined(names["environment_view"])
