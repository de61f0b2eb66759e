"""What messages call a road: several roads of a file may share a name, and ids are never shared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from athrl_driving.maps.town import Town

BY_ID = "road "
"""What stands before a road's id where it is called by that; so is each road that has no name in its file."""


def told_names(roads: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return by id what to call each of the roads (id, name): one that shares its name by its id too."""
    names = dict(roads)
    sharing = Counter(names.values())
    return {
        number: name if sharing[name] == 1 else f"{name} ({BY_ID}{number})" for number, name in names.items()
    }


def lane_called(town: Town, lane: int) -> str:
    """Return what to call a lane of a town's graph."""
    told = told_names(zip(town.road_id, town.road_name, strict=True))
    return f"lane {town.lane_id[lane]} of {told[town.road_id[lane]]}"
