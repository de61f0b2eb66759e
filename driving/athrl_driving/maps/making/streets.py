"""Streets between the places of a grid: some are left out, others joined where no third one meets them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from random import Random

Place = tuple[int, int]
"""Column and row of a place in the grid."""
Point = tuple[float, float]
"""x and y, m."""


@dataclass(frozen=True)
class Street:
    """A street between two places, by way of `corners`; an `avenue` has two lanes a direction."""

    ends: tuple[Place, Place]
    corners: tuple[Point, ...] = ()
    avenue: bool = False

    def towards(self, place: Place) -> Street:
        """The same street, seen so that it ends at `place`, which is one of its ends."""
        if self.ends[1] == place:
            return self
        return replace(self, ends=(self.ends[1], self.ends[0]), corners=self.corners[::-1])


def streets_at(place: Place, streets: Sequence[Street]) -> list[Street]:
    """The streets that end at a place."""
    return [street for street in streets if place in street.ends]


def grid(columns: int, rows: int, avenue_column: int | None, avenue_row: int | None) -> list[Street]:
    """The streets between neighbours; one column and one row may be avenues."""
    across = [
        Street(((column, row), (column + 1, row)), avenue=row == avenue_row)
        for column in range(columns - 1)
        for row in range(rows)
    ]
    along = [
        Street(((column, row), (column, row + 1)), avenue=column == avenue_column)
        for column in range(columns)
        for row in range(rows - 1)
    ]
    return across + along


def thinned_out(streets: Sequence[Street], share: float, random: Random) -> list[Street]:
    """Leave out about a `share` of the streets: no avenue, and none without which a way would end."""
    kept = list(streets)
    for street in random.sample(kept, len(kept)):
        if street.avenue or random.random() > share:
            continue
        rest = [other for other in kept if other is not street]
        if all(len(streets_at(place, rest)) >= 2 for place in street.ends) and _in_one_piece(rest):
            kept = rest
    return kept


def joined(streets: Sequence[Street], position: Mapping[Place, Point]) -> list[Street]:
    """Make one street of two that meet where no other does, with a corner there."""
    result = list(streets)
    for place, corner in position.items():
        meeting = streets_at(place, result)
        if len(meeting) != 2:
            continue
        first, second = (street.towards(place) for street in meeting)
        one = Street(
            (first.ends[0], second.ends[0]),
            (*first.corners, corner, *second.corners[::-1]),
            first.avenue and second.avenue,
        )
        result = [street for street in result if street not in meeting] + [one]
    return result


def _in_one_piece(streets: Sequence[Street]) -> bool:
    """Whether every street can be reached from every other."""
    reached: set[Place] = set()
    waiting = [streets[0].ends[0]]
    while waiting:
        place = waiting.pop()
        if place not in reached:
            reached.add(place)
            waiting += [end for street in streets_at(place, streets) for end in street.ends]
    return all(street.ends[0] in reached for street in streets)
