"""Maps that other people's libraries write are driven on, or refused in one line that names them."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.public_maps import describe, writers
from benchmarks.public_maps.trial import SECONDS, try_map

REFUSED = {
    "sumo/narrow": "it ends 0.735 m from lane -1 of road",
}
"""Maps whose file is wrong, each with what is said about it."""

SLOWEST = 0.5
"""m/s on average that the rule-based driver goes at least: it may have to wait at a red light."""


@pytest.mark.parametrize("name", writers())
def test_map_of_a_library_is_driven_or_refused_in_one_line(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"{name.replace('/', '-')}.xodr"
    writers()[name](path)
    trial = try_map(path)
    if trial.facts is None:
        assert trial.refusal.startswith(f"{path.name}: ")
        assert "\n" not in trial.refusal
        assert REFUSED[name] in trial.refusal
        return
    assert name not in REFUSED
    assert trial.metres > SLOWEST * SECONDS
    assert trial.collisions == 0


def test_every_map_says_what_it_shows() -> None:
    told = [describe(name) for name in writers()]
    assert all(told)
    assert len(set(told)) == len(told)
