"""Maps that other libraries write, and twenty seconds of driving on each."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

from benchmarks.public_maps import roadgen_maps, scenariogeneration_maps, sumo_maps

Writer = Callable[[Path], None]


def writers() -> dict[str, Writer]:
    """Return what writes each map, by "library/map"; SUMO's only where its programs are found."""
    found: dict[str, Writer] = {}
    for library, module in (("scenariogeneration", scenariogeneration_maps), ("roadgen", roadgen_maps)):
        for make in module.MAPS:
            found[f"{library}/{make.__name__}"] = partial(module.write, make)
    if shutil.which(sumo_maps.PROGRAM):
        found |= {f"sumo/{name}": partial(sumo_maps.write, name) for name in sumo_maps.MAPS}
    return found


def describe(name: str) -> str:
    """Return the sentence that says what a map shows."""
    library, _, own = name.partition("/")
    if library == "sumo":
        return sumo_maps.MAPS[own][0]
    module = {"scenariogeneration": scenariogeneration_maps, "roadgen": roadgen_maps}[library]
    return str(getattr(module, own).__doc__).rstrip(".")
