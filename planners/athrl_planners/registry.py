"""The planners by name: those of this package, and those of other installed packages.

A planner in another package needs no change here. Its package declares an entry point in its
`pyproject.toml`:

    [project.entry-points."athrl.planners"]
    mine = "my_package.my_planner:MyPlanner"
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points

from athrl_spaces.untrusted import one_short_line

from athrl_planners.planner import Planner
from athrl_planners.settings import PlannerSettings

ENTRY_POINTS = "athrl.planners"

PLANNERS: dict[str, str] = {
    "athrl": "athrl_planners.athrl:AtHRL",
    "hddpg": "athrl_planners.hddpg:HDDPG",
    "ddpg": "athrl_planners.ddpg:DDPG",
    "hdqn": "athrl_planners.hdqn:HDQN",
}


class UnknownPlanner(ValueError):  # noqa: N818  (the name says what it is)
    """There is no planner of that name, or it cannot be used; the text is one line for the user."""


@cache
def planners() -> Mapping[str, type[Planner]]:
    """Every planner by its kind.

    Raises:
        UnknownPlanner: a planner of an installed package cannot be loaded.
    """
    places = dict(PLANNERS)
    for point in entry_points(group=ENTRY_POINTS):
        places.setdefault(point.name, point.value)
    return {kind: _load(kind, place) for kind, place in places.items()}


def planner(kind: str) -> type[Planner]:
    """The planner of that kind; raises UnknownPlanner with the nearest name."""
    known = planners()
    if kind not in known:
        near = difflib.get_close_matches(kind.lower(), known, n=1, cutoff=0.4)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise UnknownPlanner(f"there is no planner {kind!r}, there are {', '.join(known)}{hint}")
    return known[kind]


def settings_tables() -> dict[str, type[PlannerSettings]]:
    """The settings of each kind of planner, for the run file's section `[planner]`."""
    return {kind: found.settings for kind, found in planners().items()}


def _load(kind: str, place: str) -> type[Planner]:
    module, _, name = place.partition(":")
    try:
        found = getattr(importlib.import_module(module), name)
    except Exception as error:  # of whatever kind: the module may be of another package
        reason = one_short_line(f"{type(error).__name__}: {error}")
        raise UnknownPlanner(f"the planner {kind} cannot be loaded from {place}: {reason}") from None
    if not (isinstance(found, type) and issubclass(found, Planner)):
        raise UnknownPlanner(f"the planner {kind} at {place} is {found!r:.60}, it should be a Planner")
    for attribute in ("kind", "summary", "settings", "action_kind"):
        if not hasattr(found, attribute):
            raise UnknownPlanner(f"the planner {kind} at {place} has no {attribute}, which it should say")
    if found.kind != kind:
        raise UnknownPlanner(
            f"the planner at {place} calls itself {found.kind!r}, it is registered as {kind!r}"
        )
    return found
