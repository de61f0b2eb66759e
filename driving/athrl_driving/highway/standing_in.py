"""Classes that stand in for a class of highway-env, so that an object can change to one and back."""

from typing import Any

_made: dict[tuple[type, type], Any] = {}


def standing_in(plain: type, features: type, metaclass: type | None = None) -> Any:
    """Return a class that is `plain`, but has the attributes of `features` (and of its bases) first.

    An object of `plain` can be given this class: `features` and its bases have empty `__slots__`. Python
    allows that only where the first bases of both classes have one layout, so `plain` stays the first base,
    and what is to be found before it is written into the new class itself.
    """
    if (plain, features) in _made:
        return _made[plain, features]
    body = {"plain": plain, "__module__": plain.__module__, "__qualname__": plain.__qualname__}
    for cls in reversed(features.__mro__[:-1]):
        body.update((name, value) for name, value in vars(cls).items() if not hasattr(type, name))
        body.update((name, vars(cls)[name]) for name in ("__setattr__", "__delattr__") if name in vars(cls))
    _made[plain, features] = (metaclass or type(plain))(plain.__name__, (plain, features), body)
    return _made[plain, features]
