"""Lane sections as one row along a road: both sides in each, none without a length."""

import itertools
from dataclasses import replace

from athrl_driving.maps.opendrive.bounds import SAME_PLACE
from athrl_driving.maps.opendrive.model import LaneSection


def with_both_sides(sections: list[LaneSection], single: list[bool]) -> list[LaneSection]:
    """Return sections that all have the lanes of both sides of the road.

    `single` tells of each whether it is of one side alone, while the other side's section goes on. Sections
    that start at one place and share no side are one section too.
    """
    if not any(single) and not any(_are_one(a, b) for a, b in itertools.pairwise(sections)):
        return sections
    rows: list[LaneSection] = []
    for section, alone in zip(sections, single, strict=True):
        lanes = dict(section.lanes)
        is_second = bool(rows) and _are_one(rows[-1], section)
        if rows and (alone or is_second):
            own = _sides(section)
            lanes |= {number: lane for number, lane in rows[-1].lanes.items() if _side(number) not in own}
        if is_second:
            rows.pop()
        rows.append(replace(section, lanes=lanes))
    _continue_lanes(rows)
    return rows


def without_empty(sections: list[LaneSection]) -> list[LaneSection]:
    """Return the sections that have a length; what led through another leads on to the one behind it."""
    kept: list[LaneSection] = []
    for section, following in itertools.zip_longest(sections, sections[1:]):
        if section.end - section.s > SAME_PLACE or (following is None and not kept):
            kept.append(section)
            continue
        if following is not None:
            _lead_through(following, section, "predecessors")
        if kept:
            _lead_through(kept[-1], section, "successors")
            kept[-1].end = section.end
        elif following is not None:
            following.s = section.s
    return kept


def _side(number: int) -> int:
    return 1 if number > 0 else -1


def _sides(section: LaneSection) -> set[int]:
    return {_side(number) for number in section.lanes}


def _are_one(first: LaneSection, second: LaneSection) -> bool:
    return first.s == second.s and not _sides(first) & _sides(second)


def _continue_lanes(rows: list[LaneSection]) -> None:
    """Link each lane that goes on from one section to the next with itself: one object in each of them."""
    pairs = list(itertools.pairwise(rows))
    carried = [
        [number for number, lane in before.lanes.items() if after.lanes.get(number) is lane]
        for before, after in pairs
    ]
    for (before, after), numbers in zip(pairs, carried, strict=True):
        for number in numbers:
            before.lanes[number] = replace(before.lanes[number], successors=[number])
            after.lanes[number] = replace(after.lanes[number], predecessors=[number])


def _lead_through(section: LaneSection, skipped: LaneSection, links: str) -> None:
    """Replace the links of a section's lanes to lanes that are skipped by those lanes' own links."""
    for lane in section.lanes.values():
        targets: list[int] = []
        for target in getattr(lane, links):
            targets += getattr(skipped.lanes[target], links) if target in skipped.lanes else [target]
        setattr(lane, links, list(dict.fromkeys(targets)))
