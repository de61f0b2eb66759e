"""The towns of a run and their shares.

They may be written as a text, a list of texts or a table of shares; the value is always a table:

| written | read |
|---|---|
| `"town03"` | `{"town03": 1.0}` |
| `["town03", "maps/mine.xodr"]` | `{"town03": 1.0, "maps/mine.xodr": 1.0}` |
| `{town03 = 2, town04 = 1}` | `{"town03": 2.0, "town04": 1.0}` |
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping
from typing import Annotated, Any

from athrl_spaces import RANDOM_TOWNS, TOWNS, is_town, nearest_town
from pydantic import BeforeValidator

from athrl_protocol.messages.schema import LONGEST_NAME

MAP_ENDING = ".xodr"
"""Of the names of maps, in capitals or small letters."""
MOST_TOWNS = 16

EXPECTED = "a town, a list of towns, or a table of their shares"
_MAY_BE = f"{', '.join(TOWNS)}, {RANDOM_TOWNS}, or an OpenDRIVE file, PATH.xodr"


def read_towns(value: Any) -> dict[str, float]:
    """Return the share of each town, a number above 0, by its name or the path of its map.

    Raises:
        ValueError: the value is not valid; says what it should be.
    """
    if isinstance(value, str):
        shares: Mapping[Any, Any] = {value: 1.0}
    elif isinstance(value, list):
        shares = _equal_shares(value)
    elif isinstance(value, Mapping):
        shares = value
    else:
        raise ValueError(f"should be {EXPECTED}")
    if not 1 <= len(shares) <= MOST_TOWNS:
        raise ValueError(f"has {len(shares)} towns, should have 1 to {MOST_TOWNS}")
    for name, share in shares.items():
        if isinstance(share, Mapping):  # town.xodr = 2.0 is a table in TOML
            raise ValueError(f"has a table as the share of {_quoted(name)}: a path has to be in quotes")
    towns = {_town(name): _share(name, share) for name, share in shares.items()}
    _require_each_map_once(list(towns))
    return towns


def _equal_shares(towns: list[Any]) -> dict[Any, float]:
    if len(towns) > MOST_TOWNS:
        raise ValueError(f"has {len(towns)} towns, should have 1 to {MOST_TOWNS}")
    for town in towns:
        if not isinstance(town, str):
            raise ValueError(f"has a town {town!r:.60}, should be {EXPECTED}")
        if towns.count(town) > 1:
            raise ValueError(f"has {_quoted(town)} twice, should have each town once; a table gives shares")
    return dict.fromkeys(towns, 1.0)


def _require_each_map_once(towns: list[str]) -> None:
    """Refuse two paths of one map, which would count as two towns."""
    seen: dict[str, str] = {}
    for town in towns:
        other = seen.setdefault(town if is_town(town) else os.path.abspath(os.path.expanduser(town)), town)
        if other is not town:
            raise ValueError(
                f"has {_quoted(other)} twice, also as {_quoted(town)}: should have each town once; a table "
                "gives shares"
            )


def _town(name: Any) -> str:
    if not isinstance(name, str):
        raise ValueError(f"has a town {name!r:.60}, should be {EXPECTED}")
    if is_town(name):
        return name
    if not name.lower().endswith(MAP_ENDING) or len(name) == len(MAP_ENDING):
        near = nearest_town(name)
        hint = f"; did you mean {near}?" if near else ""
        if name.startswith(("[", "{")) or "," in name:  # invalid TOML was taken for a text
            hint = '; the texts of a list need quotes, ["town03", "town04"], shares are numbers, {town03 = 2}'
        raise ValueError(f"{_quoted(name)} is no town: should be {_MAY_BE}{hint}")
    # It is part of results and frames, and is shown in one line.
    if len(name) > LONGEST_NAME or not name.isprintable():
        raise ValueError(f"{_quoted(name)}: should be a path of at most {LONGEST_NAME} printable characters")
    return name


def _share(name: str, share: Any) -> float:
    is_number = isinstance(share, int | float) and not isinstance(share, bool)
    if not is_number or not 0 < share <= 1e9 or not math.isfinite(share):
        raise ValueError(
            f"the share of {_quoted(name)} is {share!r:.60}, should be a number above 0, at most 1e9"
        )
    return float(share)


def _quoted(name: str) -> str:
    quoted = json.dumps(name)
    return quoted if len(quoted) <= 80 else f"{quoted[:76]}..."


Towns = Annotated[dict[str, float], BeforeValidator(read_towns)]
"""Shares by town, read from any of the forms above."""

EXPECTED_CHECKSUMS = f"a table of at most {MOST_TOWNS} SHA-256 in hexadecimal digits by path"
_SHA256 = re.compile(r"[0-9a-f]{64}")


def read_checksums(value: Any) -> dict[str, str]:
    """Return the SHA-256 of maps by path.

    Raises:
        ValueError: the value is not valid; says what it should be.
    """
    if not isinstance(value, Mapping) or len(value) > MOST_TOWNS:
        raise ValueError(f"should be {EXPECTED_CHECKSUMS}")
    for path, checksum in value.items():
        if not isinstance(path, str) or not isinstance(checksum, str) or not _SHA256.fullmatch(checksum):
            raise ValueError(f"has {checksum!r:.60} for {path!r:.80}, should be {EXPECTED_CHECKSUMS}")
    return dict(value)


MapChecksums = Annotated[dict[str, str], BeforeValidator(read_checksums)]
"""SHA-256 of maps by path."""
