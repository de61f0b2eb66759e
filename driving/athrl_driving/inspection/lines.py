"""The facts of a map as lines for people."""

from __future__ import annotations

from collections.abc import Iterator

from athrl_spaces.wording import counted

from athrl_driving.inspection.facts import MapFacts
from athrl_driving.inspection.ways import EPISODE

_NAMED = 5
_LEAST_NAMED = 0.5
"""m of a lane that is left out, from which on it is named: what is shorter is lost at a joint."""
_ENOUGH = 0.9
"""Of the way that an episode has time for: where it is less in the mean, many episodes end at the edge."""


def lines_of(facts: MapFacts) -> Iterator[tuple[str, str]]:
    """Yield the rows of the report on a map: what it is about, and what there is to say."""
    yield "file", f"OpenDRIVE {facts.opendrive or 'of an unstated revision'}, {counted(facts.roads, 'road')}"
    yield "driving lanes", f"{facts.lane_kilometres:.2f} km on {extent(facts)}"
    yield "junctions", junctions(facts)
    yield "tightest bend", _tightest(facts)
    yield "traffic lights", _lights(facts)
    yield "driven", _driven(facts)
    yield "left out", _left_out(facts)
    for fault in facts.faults:
        yield "fault", fault
    for warning in _warnings(facts):
        yield "warning", warning


def extent(facts: MapFacts) -> str:
    """Return how large a map is."""
    return " x ".join(f"{metres:,.0f}" for metres in facts.extent) + " m"


def junctions(facts: MapFacts) -> str:
    """Return how many junctions a map has."""
    if not facts.junction_arms:
        return "no junctions"
    arms = ", ".join(f"{count} of {counted(arms, 'arm')}" for arms, count in facts.junction_arms.items())
    return f"{counted(sum(facts.junction_arms.values()), 'junction')}: {arms}"


def _tightest(facts: MapFacts) -> str:
    bend = facts.bends.tightest
    if bend is None:
        return "none, all lanes are straight"
    return f"radius of {bend.radius:.1f} m, {bend.road} lane {bend.lane} at {bend.metres:.0f} m"


def _lights(facts: MapFacts) -> str:
    if not facts.traffic_lights:
        return "none"
    groups, lanes = facts.driven.light_groups, facts.driven.light_lanes
    return (
        f"{facts.traffic_lights} in the file, heeded by {counted(lanes, 'lane')} "
        f"in {counted(groups, 'group')} that change together"
    )


def _driven(facts: MapFacts) -> str:
    driven = facts.driven
    text = f"{driven.kilometres:.2f} km, {driven.share:.1%}, {counted(driven.lanes, 'lane')}"
    if driven.ways_out:
        text += f", {driven.ways_out:,} of them out of the map"
    if len(driven.parts) == 1:
        return text
    sizes = ", ".join(f"{kilometres:.2f}" for kilometres in driven.parts[:_NAMED])
    more = ", ..." if len(driven.parts) > _NAMED else ""
    return f"{text}, in {len(driven.parts)} parts without a way between them ({sizes}{more} km)"


def _left_out(facts: MapFacts) -> str:
    if not facts.left_out:
        return "nothing"
    longest = [lane for lane in facts.left_out[:_NAMED] if lane[2] >= _LEAST_NAMED]
    named = [f"{road} lane {lane} ({metres:.0f} m)" for road, lane, metres in longest]
    more = len(facts.left_out) - len(named)
    listed = ", ".join(named) + (f" and {more} more" if named and more else "")
    return (
        f"{facts.metres_left_out:,.0f} m, {1.0 - facts.driven.share:.1%}, as they lead nowhere or nothing "
        f"leads there: {listed or counted(more, 'piece') + ' at joints'}"
    )


def _warnings(facts: MapFacts) -> Iterator[str]:
    """Yield what makes a map hard to drive on, or scores on it hard to compare."""
    bends = facts.bends
    if bends.too_tight:
        yield (
            f"{counted(bends.too_tight, 'lane')} with bends tighter than the ego can steer, at full lock a "
            f"radius of {bends.ego_radius:.1f} m: drivers swing out of their lane there"
        )
    if facts.driven.mean_way < _ENOUGH * EPISODE:
        yield (
            f"episodes end early: from a random start the map ends after {facts.driven.mean_way:.0f} m in "
            f"the mean, time is for {EPISODE:.0f} m, and an end counts as arrived; set start and destination"
        )
