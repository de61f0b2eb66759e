"""A ring that tests write with small faults: two straights of 200 m and two half circles, one lane around.

Road 1 leads along y = 0 to the right, 2 turns to the left, 3 leads back along y = 60, and 4 turns again.
Tests replace road 1, or move road 3 away from its neighbours.
"""

import math
from pathlib import Path

from athrl_driving.maps import Town, load_town

LINE, ARC = "<line/>", f'<arc curvature="{1.0 / 30.0!r}"/>'
HALF_CIRCLE = 30.0 * math.pi
LINKS = '<link><predecessor id="-1"/><successor id="-1"/></link>'
WIDTH = '<width sOffset="0" a="3.5" b="0" c="0" d="0"/>'


def geometry(
    s: float, x: float, y: float, heading: float = 0.0, length: float = 200.0, shape: str = LINE
) -> str:
    place = f's="{s!r}" x="{x!r}" y="{y!r}" hdg="{heading!r}" length="{length!r}"'
    return f"<geometry {place}>{shape}</geometry>"


def lane(number: int = -1, widths: str = WIDTH, links: str = LINKS, kind: str = "driving") -> str:
    return f'<lane id="{number}" type="{kind}">{links}{widths}</lane>'


def section(*lanes: str, s: object = 0) -> str:
    return f'<laneSection s="{s}"><right>{"".join(lanes) or lane()}</right></laneSection>'


def link(tag: str, road: int, contact: str) -> str:
    return f'<{tag} elementType="road" elementId="{road}" contactPoint="{contact}"/>'


def road(
    number: int,
    plan: str,
    *,
    length: object = 200,
    sections: str = "",
    links: str = "",
    before: str = "",
    attributes: str = 'junction="-1"',
) -> str:
    """Return a road that is linked to its neighbours in the ring; `before` are elements before its lanes."""
    links = links or link("predecessor", (number - 2) % 4 + 1, "end") + link(
        "successor", number % 4 + 1, "start"
    )
    return (
        f'<road id="{number}" length="{length}" {attributes}>\n<link>{links}</link>\n'
        f"<planView>{plan}</planView>\n{before}<lanes>{sections or section()}</lanes></road>\n"
    )


def ring(first: str = "", *more: str, shift: tuple[float, float] = (0.0, 0.0)) -> str:
    """Return the ring with another road 1 and with `more` elements; road 3 is moved by `shift` (m)."""
    x, y = shift
    return "\n".join(
        [
            "<OpenDRIVE>",
            first or road(1, geometry(0, 0.0, 0.0)),
            road(2, geometry(0, 200.0, 0.0, 0.0, HALF_CIRCLE, ARC), length=HALF_CIRCLE),
            road(3, geometry(0, 200.0 + x, 60.0 + y, math.pi)),
            road(4, geometry(0, 0.0, 60.0, math.pi, HALF_CIRCLE, ARC), length=HALF_CIRCLE),
            *more,
            "</OpenDRIVE>",
        ]
    )


def town_from(folder: Path, text: str | bytes, strict: bool = False) -> Town:
    path = folder / "map.xodr"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_town(path, strict=strict)


def kinds(town: Town) -> list[str]:
    """Return what was found, each kind once."""
    return list(dict.fromkeys(finding.kind for finding in town.findings))


def metres(town: Town) -> float:
    """Return the length of all lanes that are driven on."""
    distinct = dict(zip(town.lane_indices, town.graph.length.tolist(), strict=True))
    return sum(distinct.values())
