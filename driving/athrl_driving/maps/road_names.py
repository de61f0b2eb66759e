"""What messages call a road: several roads of a file may share a name, and ids are never shared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

BY_ID = "road "
"""What stands before a road's id where it is called by that; so is each road that has no name in its file."""


def told_names(roads: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return by id what to call each of the roads (id, name): one that shares its name by its id too."""
    names = dict(roads)
    sharing = Counter(names.values())
    return {
        number: name if sharing[name] == 1 else f"{name} ({BY_ID}{number})" for number, name in names.items()
    }
