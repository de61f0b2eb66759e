"""The names of towns: those that the project ships, and the random ones, of which each seed gives another."""

from __future__ import annotations

import difflib
import re

TOWNS = ("town02", "town03", "town04")
"""The towns that the project ships."""

LARGEST_TOWN_SEED = 999_999_999
RANDOM_TOWNS = f"random-1 to random-{LARGEST_TOWN_SEED}"
"""What an error says of the names of random towns."""

_RANDOM = re.compile(r"random-([1-9][0-9]{0,8})", re.ASCII)


def town_seed(name: str) -> int | None:
    """The seed of a random town, 7 for `random-7`; None for any other name."""
    found = _RANDOM.fullmatch(name)
    return None if found is None else int(found[1])


def is_town(name: str) -> bool:
    """Whether a name is that of a town, and not the path of a map."""
    return name in TOWNS or town_seed(name) is not None


def nearest_town(name: str) -> str | None:
    """The name that is meant by a misspelt one, perhaps; None if no name is like it."""
    number = re.fullmatch(r"[\W_]*random[\W_]*0*([1-9][0-9]{0,8})[\W_]*", name.lower(), re.ASCII)
    if number is not None:
        return f"random-{number[1]}"
    return next(iter(difflib.get_close_matches(name.lower(), TOWNS, n=1)), None)
