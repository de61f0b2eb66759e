"""What was found wrong in a map while it was read, and what was done about it: one warning for each kind.

Maps that people have contain small faults: a jump of a centimetre between two roads, a link to a road that
was cut away. A car can drive over them, so they are bridged or the one lane is left out. Whoever uses the map
must be told once, and not once for each of a thousand lanes.
"""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field

from athrl_driving.errors import DrivingError

_LONG = 10.0
"""Metres from which on millimetres have no meaning."""

_log = logging.getLogger(__name__)


class MapError(DrivingError):
    """A map that cannot be driven on: one line that names the file, the road, the lane and the line."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault of one kind at one place.

    `kind` says in one phrase what was found and what was done, the same words for each of its kind: "a gap
    between linked lanes was bridged". `place` says where ("road 5, lane -1, line 12"), `metres` how large it
    is, None where that has no meaning.
    """

    kind: str
    place: str
    metres: float | None = None


@dataclass(slots=True)
class Findings:
    """All faults of a map that did not stop it from being read; none are tolerated where it is strict."""

    name: str
    """Of the map's file."""
    strict: bool = False
    """Whether the first fault is an error."""
    _found: dict[str, dict[str, Finding]] = field(default_factory=dict)
    """By kind and place."""

    def add(self, kind: str, place: str, metres: float | None = None, *, allowed: bool = False) -> None:
        """Note a fault; of one kind at one place only the largest is kept.

        `allowed` is for what the standard allows and is passed over here: it is no error in a strict map.
        Raises `MapError` where the map is read strictly.
        """
        finding = Finding(kind, place, metres)
        if self.strict and not allowed:
            would = Finding(_not_done(kind), place, metres)
            raise MapError(f"{self.name}: {place}: {_described(would)}, but the map is read strictly")
        here = self._found.setdefault(kind, {})
        if place not in here or _size(finding) > _size(here[place]):
            here[place] = finding

    def __iter__(self) -> Iterator[Finding]:
        """Yield every finding, kind by kind."""
        for places in self._found.values():
            yield from places.values()

    def lines(self) -> list[str]:
        """Return one line for each kind: how often it was found, the largest one and where that is."""
        lines = []
        for kind, places in self._found.items():
            worst = max(places.values(), key=_size)
            if len(places) == 1:
                lines.append(f"{self.name}: {_described(worst)}: {worst.place}")
                continue
            first = "the first" if worst.metres is None else f"the largest of {_told(worst.metres)}"
            lines.append(f"{self.name}: {kind} ({len(places)} times), {first}: {worst.place}")
        return lines

    def warn(self) -> None:
        """Log each kind once, as a warning, which Python shows unless it is told not to."""
        for line in self.lines():
            _log.warning("%s", line)


def _size(finding: Finding) -> float:
    return 0.0 if finding.metres is None else finding.metres


def _described(finding: Finding) -> str:
    return finding.kind if finding.metres is None else f"{finding.kind} ({_told(finding.metres)})"


def _told(metres: float) -> str:
    """Return a length with no more digits than it can mean: gaps are some mm, roads some hundred m."""
    return f"{metres:.3f} m" if metres < _LONG else f"{metres:.0f} m"


def _not_done(kind: str) -> str:
    """Return a kind, which says what was done, as what would be done in a map that is not read strictly."""
    before, verb, after = max((kind.rpartition(f" {verb} ") for verb in ("was", "were")), key=_length_before)
    negation = "not " if after.startswith("not ") else ""
    return f"{before} would {negation}be {after.removeprefix('not ')}" if verb else kind


def _length_before(parts: tuple[str, str, str]) -> int:
    return len(parts[0])
