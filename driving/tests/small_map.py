"""Small maps for tests: roads, a crossing, rings; written as OpenDRIVE files."""

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from athrl_driving.maps import Town, load_town

JUNCTION, NEAR, HALF_LANE = 9, 12.0, 1.75

End = tuple[int, str]
"""A road, and "start" or "end"."""

Pose = tuple[float, float, float]


class SmallMap:
    """Builds an OpenDRIVE file of a few roads with lanes of 3.5 m; a road's lanes keep their ids along it."""

    def __init__(self) -> None:
        self._roads = self._connections = ""

    def road(
        self,
        number: int,
        start: Pose,
        shapes: Sequence[tuple[float, float]],
        lanes: Sequence[int] = (1, -1),
        before: End | int | None = None,
        after: End | int | None = None,
    ) -> Pose:
        """Add a road of (length, curvature) pieces, linked to other roads or a junction; return its end.

        Where two ends or two starts meet, lanes go on with the opposite ids.
        """
        plan, length, end = _plan(start, shapes)
        back = -1 if isinstance(before, tuple) and before[1] == "start" else 1
        on = -1 if isinstance(after, tuple) and after[1] == "end" else 1
        sides = ""
        for side, own in (("left", [n for n in lanes if n > 0]), ("right", [n for n in lanes if n < 0])):
            if own:
                own.sort(reverse=True)
                sides += f"<{side}>{''.join(_lane(n, back * n, on * n) for n in own)}</{side}>"
        self._add(number, length, plan, sides, _link("predecessor", before) + _link("successor", after))
        return end

    def crossing(
        self, arms: Sequence[float], turns: bool = True, after: Mapping[int, End] | None = None
    ) -> None:
        """Add roads 0 to 3 at right angles around the origin, of these lengths (0: none), that meet there.

        Without `turns` vehicles only drive straight on. `after` is what arms lead to.
        """
        for arm, length in enumerate(arms):
            angle = 0.5 * math.pi * arm
            if length:
                start = (NEAR * math.cos(angle), NEAR * math.sin(angle), angle)
                self.road(arm, start, [(length, 0.0)], before=JUNCTION, after=(after or {}).get(arm))
        there = [arm for arm, length in enumerate(arms) if length]
        for origin, target in itertools.permutations(there, 2):
            if turns or (target - origin) % 4 == 2:
                self._connect(origin, target)

    def ring(self, number: int, y: float, lanes: Sequence[int] = (1, -1)) -> None:
        """Add a ring road: roads `number` and `number + 1`, two straights of 100 m and two bends."""
        bend, there, back = (30.0 * math.pi, 1.0 / 30.0), number, number + 1
        end = self.road(there, (0.0, y, 0.0), [(100.0, 0.0), bend], lanes, (back, "end"), (back, "start"))
        self.road(back, end, [(100.0, 0.0), bend], lanes, (there, "end"), (there, "start"))

    def _connect(self, origin: int, target: int) -> None:
        """Add the connecting road from one arm of the crossing to another."""
        angle, number = 0.5 * math.pi * origin, 100 + 10 * origin + target
        cos, sin = math.cos(angle), math.sin(angle)
        start = (NEAR * cos - HALF_LANE * sin, NEAR * sin + HALF_LANE * cos, angle + math.pi)
        radius = {1: -(NEAR - HALF_LANE), 3: NEAR + HALF_LANE}.get((target - origin) % 4, 0.0)
        shape = (0.5 * math.pi * abs(radius), 1.0 / radius) if radius else (2.0 * NEAR, 0.0)
        plan, length, _ = _plan(start, [shape])
        links = _link("predecessor", (origin, "start")) + _link("successor", (target, "start"))
        self._add(number, length, plan, f"<right>{_lane(-1, 1, -1)}</right>", links, HALF_LANE, JUNCTION)
        self._connections += (
            f'<connection id="{number}" incomingRoad="{origin}" connectingRoad="{number}" '
            'contactPoint="start"><laneLink from="1" to="-1"/></connection>'
        )

    def _add(
        self, number: int, length: float, plan: str, sides: str, links: str,
        offset: float = 0.0, junction: int = -1,
    ) -> None:  # fmt: skip
        self._roads += (
            f'<road id="{number}" name="road {number}" length="{length}" junction="{junction}">'
            f"<link>{links}</link><planView>{plan}</planView>"
            f'<lanes><laneOffset s="0" a="{offset}" b="0" c="0" d="0"/>'
            f'<laneSection s="0">{sides}</laneSection></lanes></road>\n'
        )

    def write(self, folder: Path) -> Path:
        """Write the map to a folder; return its path."""
        junction = f'<junction id="{JUNCTION}" name="the crossing">{self._connections}</junction>'
        path = folder / "small.xodr"
        path.write_text(f"<OpenDRIVE>\n{self._roads}{junction if self._connections else ''}</OpenDRIVE>")
        return path

    def load(self, folder: Path) -> Town:
        """Write the map to a folder and load it."""
        return load_town(self.write(folder))


def _plan(start: Pose, shapes: Sequence[tuple[float, float]]) -> tuple[str, float, Pose]:
    """Return the geometries of a reference line, its length and where it ends."""
    (x, y, heading), plan, s = start, "", 0.0
    for length, curvature in shapes:
        shape = f'<arc curvature="{curvature}"/>' if curvature else "<line/>"
        plan += f'<geometry s="{s}" x="{x}" y="{y}" hdg="{heading}" length="{length}">{shape}</geometry>'
        half, s = 0.5 * curvature * length, s + length
        chord = length * math.sin(half) / half if half else length
        x, y = x + chord * math.cos(heading + half), y + chord * math.sin(heading + half)
        heading += 2.0 * half
    return plan, s, (x, y, heading)


def _link(tag: str, to: End | int | None) -> str:
    if to is None:
        return ""
    if isinstance(to, int):
        return f'<{tag} elementType="junction" elementId="{to}"/>'
    return f'<{tag} elementType="road" elementId="{to[0]}" contactPoint="{to[1]}"/>'


def _lane(number: int, before: int, after: int) -> str:
    links = f'<predecessor id="{before}"/><successor id="{after}"/>'
    width = '<width sOffset="0" a="3.5" b="0" c="0" d="0"/>'
    return f'<lane id="{number}" type="driving"><link>{links}</link>{width}</lane>'
