"""Every kind of OpenDRIVE geometry lies where its definition says, within a centimetre.

The definitions are integrated here once more, by plain sums of small steps, and the lanes of a road that is
written to a file and read back are compared with them.
"""

import itertools
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from athrl_driving.maps.opendrive import read_opendrive
from athrl_driving.maps.opendrive.carriageways import LaneSegment
from athrl_driving.maps.opendrive.model import Geometry
from athrl_driving.maps.opendrive.reference_line import geometry_poses
from athrl_driving.maps.opendrive.roadway import build_roadway
from hypothesis import given, settings
from hypothesis import strategies as st

STEPS = 40_000


def real(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda value: round(value, 6))


LINES = st.tuples(st.just("line"), st.just(()))
ARCS = st.tuples(st.just("arc"), st.tuples(real(-0.05, 0.05)))
SPIRALS = st.tuples(st.just("spiral"), st.tuples(real(-0.06, 0.06), real(-0.06, 0.06)))
CUBICS = st.tuples(
    st.just("poly3"),
    st.tuples(st.just(0.0), real(-0.2, 0.2), real(-0.004, 0.004), real(-0.00004, 0.00004)),
)
PARAMETRIC = st.tuples(
    st.just("paramPoly3"),
    st.tuples(
        st.just(0.0),
        real(0.9, 1.0),
        real(-0.002, 0.002),
        real(-0.00002, 0.00002),
        st.just(0.0),
        real(-0.1, 0.1),
        real(-0.004, 0.004),
        real(-0.00004, 0.00004),
        st.just(0.0),
    ),
)


@st.composite
def geometries(draw: st.DrawFn) -> Geometry:
    kind, parameters = draw(st.one_of(LINES, ARCS, SPIRALS, CUBICS, PARAMETRIC))
    length = draw(real(5.0, 60.0))
    if kind == "paramPoly3" and draw(st.booleans()):
        # The same curve with a parameter from 0 to 1.
        powers = [length**power for power in (0, 1, 2, 3)] * 2
        parameters = (*(a * b for a, b in zip(parameters, powers, strict=False)), 1.0)
    start = (draw(real(-500.0, 500.0)), draw(real(-500.0, 500.0)), draw(real(-3.0, 3.0)))
    return Geometry(0.0, *start, length, kind, parameters, 1)


def defined(geometry: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Return stations [STEPS + 1] and points [STEPS + 1, 2] of a geometry by its definition."""
    s = np.linspace(0.0, geometry.length, STEPS + 1)
    values = geometry.parameters
    if geometry.kind in ("line", "arc", "spiral"):
        start, end = {"line": (0.0, 0.0), "arc": values * 2, "spiral": values}[geometry.kind]
        middle = 0.5 * (s[1:] + s[:-1])
        angle = start * middle + 0.5 * (end - start) / geometry.length * middle**2
        step = geometry.length / STEPS
        u = np.concatenate([[0.0], np.cumsum(np.cos(angle) * step)])
        v = np.concatenate([[0.0], np.cumsum(np.sin(angle) * step)])
    elif geometry.kind == "poly3":
        along = np.linspace(0.0, geometry.length, STEPS + 1)
        height = sum(value * along**power for power, value in enumerate(values))
        travelled = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(along), np.diff(height)))])
        u, v = np.interp(s, travelled, along), np.interp(s, travelled, height)
    else:
        p = s / geometry.length if values[8] else s
        u = sum(value * p**power for power, value in enumerate(values[:4]))
        v = sum(value * p**power for power, value in enumerate(values[4:8]))
    cos, sin = math.cos(geometry.heading), math.sin(geometry.heading)
    return s, np.stack([geometry.x + u * cos - v * sin, geometry.y + u * sin + v * cos], axis=1)


@settings(deadline=None, max_examples=100)
@given(geometry=geometries())
def test_a_reference_line_is_where_its_definition_says(geometry: Geometry) -> None:
    s, points = defined(geometry)
    places = np.arange(0, STEPS + 1, STEPS // 20)
    poses = geometry_poses(geometry, s[places])
    np.testing.assert_allclose(np.stack([poses.x, poses.y], axis=1), points[places], atol=1e-5)
    directions = np.gradient(points, axis=0)[places]
    expected = np.arctan2(directions[:, 1], directions[:, 0])
    turned = (poses.heading - expected + math.pi) % (2.0 * math.pi) - math.pi
    np.testing.assert_allclose(turned[1:-1], 0.0, atol=1e-4)


NAMES = {
    "line": (),
    "arc": ("curvature",),
    "spiral": ("curvStart", "curvEnd"),
    "poly3": ("a", "b", "c", "d"),
    "paramPoly3": ("aU", "bU", "cU", "dU", "aV", "bV", "cV", "dV"),
}


def cubic(tag: str, station: str, values: tuple[float, ...]) -> str:
    numbers = " ".join(f'{name}="{value!r}"' for name, value in zip("abcd", values, strict=True))
    return f'<{tag} {station}="0" {numbers}/>'


def road_file(geometry: Geometry, rule: str, offset: tuple[float, ...], width: tuple[float, ...]) -> str:
    names = NAMES[geometry.kind]
    shape = " ".join(f'{name}="{value!r}"' for name, value in zip(names, geometry.parameters, strict=False))
    if geometry.kind == "paramPoly3":
        shape += f' pRange="{"normalized" if geometry.parameters[8] else "arcLength"}"'
    place = f'x="{geometry.x!r}" y="{geometry.y!r}" hdg="{geometry.heading!r}" length="{geometry.length!r}"'

    def lane(number: int) -> str:
        return f'<lane id="{number}" type="driving">{cubic("width", "sOffset", width)}</lane>'

    return f"""<OpenDRIVE><road id="1" length="{geometry.length!r}" junction="-1" rule="{rule}">
    <planView><geometry s="0" {place}><{geometry.kind} {shape}/></geometry></planView>
    <lanes>{cubic("laneOffset", "s", offset)}<laneSection s="0">
    <left>{lane(2)}{lane(1)}</left><right>{lane(-1)}{lane(-2)}</right>
    </laneSection></lanes></road></OpenDRIVE>"""


def polynomial(values: tuple[float, ...], s: np.ndarray) -> np.ndarray:
    return np.asarray(sum(value * s**power for power, value in enumerate(values)))


def chained(segments: list[LaneSegment], spacing: float) -> np.ndarray:
    return np.array(
        [
            segment.at(float(s))[:2]
            for segment in segments
            for s in np.linspace(0.0, segment.length, 2 + int(segment.length / spacing))
        ]
    )


def distance_to_line(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return how far points [n, 2] are from a polyline [m, 2]."""
    start, along = line[:-1], np.diff(line, axis=0)
    squared = np.maximum((along**2).sum(axis=1), 1e-18)
    result = []
    for point in points:
        share = np.clip(((point - start) * along).sum(axis=1) / squared, 0.0, 1.0)
        result.append(np.linalg.norm(start + share[:, None] * along - point, axis=1).min())
    return np.array(result)


@settings(deadline=None, max_examples=60)
@given(
    geometry=geometries(),
    rule=st.sampled_from(["RHT", "LHT"]),
    offset=st.tuples(real(-2.0, 2.0), real(-0.05, 0.05), real(-0.001, 0.001), real(-0.00001, 0.00001)),
    width=st.tuples(real(3.0, 3.8), real(-0.01, 0.02), real(0.0, 0.0004), real(-0.000001, 0.000001)),
)
def test_lanes_are_within_a_centimetre_of_their_definition(
    geometry: Geometry, rule: str, offset: tuple[float, ...], width: tuple[float, ...]
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "road.xodr"
        path.write_text(road_file(geometry, rule, offset, width))
        roadway = build_roadway(read_opendrive(path))
    s, points = defined(geometry)
    direction = np.gradient(points, axis=0)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    for lane in (2, 1, -1, -2):
        t = polynomial(offset, s) + math.copysign(abs(lane) - 0.5, lane) * polynomial(width, s)
        true = (points + t[:, None] * normal)[:: STEPS // 4000] * (1.0, -1.0)
        segments = [
            segment
            for carriageway in roadway.carriageways
            for segment in carriageway.lanes
            if segment.lane.id == lane
        ]
        forward = (lane > 0) == (rule == "LHT")
        if not forward:
            true = true[::-1]
        sampled = chained(segments, 0.7)
        assert distance_to_line(sampled, true).max() < 0.01
        assert distance_to_line(true[::100], chained(segments, 0.05)).max() < 0.01
        np.testing.assert_allclose(sampled[[0, -1]], true[[0, -1]], atol=0.01)
        for segment, following in itertools.pairwise(segments):
            assert segment.successors == [following]
            x, y, heading = segment.at(segment.length)
            assert math.hypot(following.x - x, following.y - y) < 1e-3
            assert math.cos(following.heading - heading) > math.cos(0.02)


@pytest.mark.parametrize("rule", ["RHT", "LHT"])
def test_neighbours_are_in_order_from_the_drivers_left(tmp_path: Path, rule: str) -> None:
    path = tmp_path / "road.xodr"
    line = Geometry(0.0, 0.0, 0.0, 0.0, 50.0, "line", (), 1)
    path.write_text(road_file(line, rule, (0.0, 0.0, 0.0, 0.0), (3.5, 0.0, 0.0, 0.0)))
    carriageways = build_roadway(read_opendrive(path)).carriageways
    expected = [[-1, -2], [1, 2]] if rule == "RHT" else [[2, 1], [-2, -1]]
    assert [[segment.lane.id for segment in carriageway.lanes] for carriageway in carriageways] == expected
    for carriageway in carriageways:
        left, right = carriageway.lanes
        assert left.may_right
        assert right.may_left
        across = (right.y - left.y) * math.cos(left.heading) - (right.x - left.x) * math.sin(left.heading)
        assert across == pytest.approx(3.5)
