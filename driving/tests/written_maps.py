"""Small OpenDRIVE maps that tests write, and what they ask of the towns made of them."""

import itertools
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from athrl_driving.maps import Town, load_town

NEAR, LENGTH, HALF_LANE = 12.0, 60.0, 1.75


def element(tag: str, content: str = "", **attributes: object) -> str:
    text = " ".join(f'{name}="{value}"' for name, value in attributes.items())
    return f"<{tag} {text}>{content}</{tag}>\n"


def lane(number: int, *, before: int | None = None, after: int | None = None, width: float = 3.5) -> str:
    links = element("predecessor", id=before) if before is not None else ""
    links += element("successor", id=after) if after is not None else ""
    widths = element("width", sOffset=0, a=width, b=0, c=0, d=0)
    return element("lane", element("link", links) + widths, id=number, type="driving")


def road(
    number: int,
    shape: str,
    start: tuple[float, float, float],
    length: float,
    lanes: str,
    links: str = "",
    offset: float = 0.0,
    height: float = 0.0,
    more: str = "",
    **attributes: object,
) -> str:
    x, y, heading = start
    plan = element("planView", element("geometry", shape, s=0, x=x, y=y, hdg=heading, length=length))
    profile = element("elevationProfile", element("elevation", s=0, a=height, b=0, c=0, d=0))
    offsets = element("laneOffset", s=0, a=offset, b=0, c=0, d=0)
    section = element("lanes", offsets + element("laneSection", lanes, s=0))
    content = element("link", links) + plan + profile + section + more
    return element("road", content, id=number, length=length, **{"junction": -1, **attributes})


def linked(tag: str, number: int, contact: str) -> str:
    return element(tag, elementType="road", elementId=number, contactPoint=contact)


def connecting(
    number: int,
    junction: int,
    start: tuple[float, float, float],
    shape: str,
    length: float,
    ends: tuple[tuple[int, str, int], tuple[int, str, int]],
    height: float = 0.0,
) -> tuple[str, str]:
    """Return a connecting road and its connection; `ends` are (road, contact, lane) before and after."""
    (before, contact, lane_before), (after, contact_after, lane_after) = ends
    links = linked("predecessor", before, contact) + linked("successor", after, contact_after)
    lanes = element("right", lane(-1, before=lane_before, after=lane_after))
    connecting_road = road(number, shape, start, length, lanes, links, HALF_LANE, height, junction=junction)
    link = element("laneLink", **{"from": lane_before, "to": -1})
    return connecting_road, element(
        "connection", link, id=number, incomingRoad=before, connectingRoad=number, contactPoint="start"
    )


def crossing(
    arms: Iterable[int] = range(4),
    signals: bool = False,
    more: str = "",
    more_in_junction: str = "",
    length: float = LENGTH,
) -> str:
    """Four roads that meet at the origin, each with a lane in each direction that turns at the far end."""
    result, turns, roads, connections = "", "", "", ""
    for arm in arms:
        angle = 0.5 * math.pi * arm
        cos, sin = round(math.cos(angle)), round(math.sin(angle))
        light = element("signal", id=f"s{arm}", s=0.5, t=3, type=1000001, dynamic="yes", orientation="-")
        lanes = element("left", lane(1)) + element("right", lane(-1))
        links = element("predecessor", elementType="junction", elementId=9)
        links += element("successor", elementType="junction", elementId=20 + arm)
        start = (NEAR * cos, NEAR * sin, angle)
        result += road(
            arm, "<line/>", start, length, lanes, links, more=element("signals", light if signals else "")
        )
        far = NEAR + length
        connecting_road, connection = connecting(
            200 + arm,
            20 + arm,
            (far * cos + HALF_LANE * sin, far * sin - HALF_LANE * cos, angle),
            element("arc", curvature=1.0 / HALF_LANE),
            math.pi * HALF_LANE,
            ((arm, "end", -1), (arm, "end", 1)),
        )
        turns += connecting_road + element("junction", connection, id=20 + arm, name=f"turn {arm}")
    for origin, target in itertools.permutations(arms, 2):
        angle = 0.5 * math.pi * origin
        cos, sin = round(math.cos(angle)), round(math.sin(angle))
        start = (NEAR * cos - HALF_LANE * sin, NEAR * sin + HALF_LANE * cos, angle + math.pi)
        turn = (target - origin) % 4
        radius = {1: -(NEAR - HALF_LANE), 3: NEAR + HALF_LANE}.get(turn, 0.0)
        shape = "<line/>" if turn == 2 else element("arc", curvature=1.0 / radius)
        length = 2.0 * NEAR if turn == 2 else 0.5 * math.pi * abs(radius)
        ends = ((origin, "start", 1), (target, "start", -1))
        connecting_road, connection = connecting(100 + 10 * origin + target, 9, start, shape, length, ends)
        roads, connections = roads + connecting_road, connections + connection
    junction = element("junction", connections + more_in_junction, id=9, name="the crossing")
    return f"<OpenDRIVE>\n{result}{turns}{roads}{junction}{more}</OpenDRIVE>"


def town_from(folder: Path, text: str) -> Town:
    path = folder / "map.xodr"
    path.write_text(text)
    return load_town(path)


def movement(town: Town, origin: int, target: int) -> int:
    """Return the movement from one arm of the crossing to another."""
    start = [town.road_name[index] for index in town.movements.origin]
    end = [town.road_name[index] for index in town.movements.exit]
    wanted = (f"road {origin}", f"road {target}")
    (found,) = [place for place, names in enumerate(zip(start, end, strict=True)) if names == wanted]
    return found


def are_in_conflict(town: Town, first: int, second: int) -> bool:
    start = town.movements.conflict_start
    return second in town.movements.conflict[start[first] : start[first + 1]]


def greens_overlap(town: Town, first: int, second: int) -> bool:
    signals = town.signals
    cycle = signals.cycle[first]
    times = np.arange(0.0, cycle, 0.25)

    def is_open(group: int) -> np.ndarray:
        length = (signals.green_until[group] - signals.green_from[group]) % cycle + signals.yellow[group]
        return (times - signals.green_from[group]) % cycle < length

    return bool((is_open(first) & is_open(second)).any())


def with_signals(text: str, number: int, signals: str) -> str:
    """Return the map with more signals on a road."""
    before, road_and_after = text.split(f'<road id="{number}" ', 1)
    own, after = road_and_after.split("</road>", 1)
    return f'{before}<road id="{number}" {own}{element("signals", signals)}</road>{after}'


def light(tag: str, name: str, *, lanes: tuple[int, int] | None = None, **attributes: object) -> str:
    """Return a `<signal>`, or a `<signalReference>` to one, of a traffic light."""
    validity = element("validity", fromLane=lanes[0], toLane=lanes[1]) if lanes else ""
    kind = {"type": 1000001, "dynamic": "yes"} if tag == "signal" else {}
    return element(tag, validity, **{"id": name, "s": 0.5, "t": 3, "orientation": "-", **kind, **attributes})


def controller(name: str, signals: Iterable[str]) -> str:
    return element("controller", "".join(element("control", signalId=signal) for signal in signals), id=name)
