"""Things that belong together because they are joined one by one (union-find)."""

from collections.abc import Hashable, Iterable
from typing import Generic, TypeVar

T = TypeVar("T", bound=Hashable)


class DisjointSets(Generic[T]):
    """Sets of things; what was never joined is a set of its own."""

    def __init__(self, things: Iterable[T] = ()) -> None:
        self._parent = {thing: thing for thing in things}

    def root(self, thing: T) -> T:
        """Return the thing that stands for all that are joined with this one."""
        self._parent.setdefault(thing, thing)
        while self._parent[thing] != thing:
            self._parent[thing] = self._parent[self._parent[thing]]
            thing = self._parent[thing]
        return thing

    def join(self, thing: T, other: T) -> None:
        """Join two things and all that belongs to them; the first one's root stands for them."""
        self._parent[self.root(other)] = self.root(thing)

    def sets(self) -> dict[T, list[T]]:
        """Return the things of every set by its root, in the order in which they were first named."""
        result: dict[T, list[T]] = {}
        for thing in self._parent:
            result.setdefault(self.root(thing), []).append(thing)
        return result
