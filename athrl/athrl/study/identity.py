"""What a study is: rows, seeds and places may be added to it, but what is compared stays the same."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from athrl.errors import CommandError
from athrl.study.file import StudyFile
from athrl.study.plan import PlannedRun

_GROWING = ("runs", "elsewhere")
"""What may be added to, and left out again."""


def identity(study: StudyFile, runs: Sequence[PlannedRun]) -> dict[str, Any]:
    """Return the name, the scored episodes, the search, each run's recipe and the places of a study."""
    search = study.search.model_dump(exclude={"trials"}) if study.search is not None else None
    document = {
        "study": study.study.name,
        "scoring": study.scoring.model_dump(),
        "search": search,
        "runs": {run.name: run.recipe for run in runs},
        "elsewhere": {place.name: place.model_dump() for place in study.elsewhere},
    }
    return dict(json.loads(json.dumps(document)))  # as it is read from a file


def joined(holder: str, begun: Mapping[str, Any], wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Return what was begun with what is wanted now added to it.

    Args:
        holder: what holds the begun one, for the error, such as `--out FOLDER`.
        begun: its `identity` when it was begun.
        wanted: its `identity` now.

    Raises:
        CommandError: they are different studies; names the first difference.
    """
    for key, value in wanted.items():
        if key not in _GROWING:
            _require_same(holder, key, begun.get(key), value)
    for key, what in zip(_GROWING, ("run", "elsewhere"), strict=True):
        for name, value in wanted[key].items():
            _require_same(holder, f"{what} {name}", begun.get(key, {}).get(name, value), value)
    return {**wanted, **{key: {**begun.get(key, {}), **wanted[key]} for key in _GROWING}}


def _require_same(holder: str, what: str, begun: Any, wanted: Any) -> None:
    if begun != wanted:
        what, begun, wanted = _first_difference(what, begun, wanted)
        raise CommandError(
            f"{holder}: holds another study: {what} was begun as {begun}, should be {wanted}; name another"
        )


def _first_difference(what: str, begun: Any, wanted: Any) -> tuple[str, Any, Any]:
    """Return where two documents differ, and what is there in each; of lists what the other lacks."""
    if isinstance(begun, dict) and isinstance(wanted, dict):
        for key in [*begun, *wanted]:
            if begun.get(key) != wanted.get(key):
                return _first_difference(f"{what}, {key}", begun.get(key), wanted.get(key))
    if isinstance(begun, list) and isinstance(wanted, list):
        only = [each for each in begun if each not in wanted], [each for each in wanted if each not in begun]
        if any(only):
            return what, *only
    return what, begun, wanted
