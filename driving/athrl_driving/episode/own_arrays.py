"""The arrays of episodes by name, for copies of them in this process, in another one or in a file.

A town's arrays are not among them: they are large, and a copy has those of its own town.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from athrl_driving.episode.state import EpisodeState
from athrl_driving.errors import DrivingError

_NOT_OWN = frozenset(
    {
        "settings",
        "perception",
        *(f"traffic.{part}" for part in ("graph", "movements", "signals", "lane_links", "conflict_zones")),
        "routes.lanes_reach",
        "observations.recording_buffer.seen",  # the same memory as `observations.images`
    }
)
"""Parts of the state that are made from the town and the settings, or are a view of another part."""


def own_arrays(state: EpisodeState) -> dict[str, NDArray]:
    """Return all arrays of the episodes themselves, named by their place: `progress.ego`."""
    return dict(_arrays(state, ""))


def fill_own_arrays(state: EpisodeState, arrays: Mapping[str, Any]) -> None:
    """Copy the values of `arrays` into those of a state for the same town and settings.

    Raises `DrivingError`, in one line, and copies nothing for a name, a shape or a dtype that does not fit.
    """
    own = own_arrays(state)
    if own.keys() != arrays.keys():
        name = min(own.keys() ^ arrays.keys())
        raise DrivingError(f"they have {'no' if name in own else 'an unknown'} array {name}")
    for name, array in own.items():
        found = np.asarray(arrays[name])
        if (found.shape, found.dtype) != (array.shape, array.dtype):
            raise DrivingError(
                f"{name} is {found.dtype} {list(found.shape)}, should be {array.dtype} {list(array.shape)}"
            )
    for name, array in own.items():
        array[...] = arrays[name]


def _arrays(value: tuple, path: str) -> Iterator[tuple[str, NDArray]]:
    """Yield the arrays of a named tuple and of those in it."""
    for name, field in value._asdict().items():  # type: ignore[attr-defined]
        place = f"{path}{name}"
        if place in _NOT_OWN:
            continue
        if isinstance(field, np.ndarray):
            yield place, field
        else:
            yield from _arrays(field, f"{place}.")
