"""Classes made of a class of highway-env and a mixin, so that an object can change its class and back.

No module has these classes by name, so their objects are pickled with the two classes that theirs is made of.
"""

from typing import Any

_made: dict[tuple[type, type], Any] = {}


def class_with_mixin(plain: type, mixin: type, metaclass: type | None = None) -> Any:
    """Return a subclass of `plain` in which the attributes of `mixin` (and its bases) take precedence.

    The class of an object of `plain` can be set to it: `mixin` and its bases have empty `__slots__`. Python
    allows that only if the first bases of both classes have the same layout, so `plain` stays the first base,
    and the attributes that take precedence are written into the new class itself.
    """
    if (plain, mixin) in _made:
        return _made[plain, mixin]
    body = {
        "plain": plain,
        "__module__": plain.__module__,
        "__qualname__": plain.__qualname__,
        "__reduce__": _reduce,
    }
    for cls in reversed(mixin.__mro__[:-1]):
        body.update((name, value) for name, value in vars(cls).items() if not hasattr(type, name))
        body.update((name, vars(cls)[name]) for name in ("__setattr__", "__delattr__") if name in vars(cls))
    _made[plain, mixin] = (metaclass or type(plain))(plain.__name__, (plain, mixin), body)
    return _made[plain, mixin]


def _reduce(self: Any) -> tuple:
    """How an object of such a class is pickled and copied: both classes, and its attributes."""
    cls = type(self)
    return _empty, (*cls.__bases__, type(cls)), self.__getstate__()


def _empty(plain: type, mixin: type, metaclass: type) -> Any:
    """Return an object without attributes."""
    cls = class_with_mixin(plain, mixin, metaclass)
    return cls.__new__(cls)
