"""The compiled geometry is highway-env's."""

import math

import numpy as np
import pytest
from athrl_driving.maps import closest_lane, lane_pose, lane_project, load_town
from athrl_driving.maps.curves import Pose, join, rounded_polyline, wrap
from hypothesis import given, settings
from hypothesis import strategies as st

TOWN = load_town("town03")
ROWS = st.integers(0, len(TOWN.graph.length) - 1)
SHARES = st.floats(0.0, 1.0)
LATERALS = st.floats(-6.0, 6.0)


@settings(deadline=None)
@given(row=ROWS, share=SHARES)
def test_poses_are_those_of_highway_env(row: int, share: float) -> None:
    lane = TOWN.network.get_lane(TOWN.lane_indices[row])
    s = share * lane.length
    x, y, heading = lane_pose(TOWN.graph, row, s)
    assert lane.length == pytest.approx(TOWN.graph.length[row], abs=1e-9)
    np.testing.assert_allclose((x, y), lane.position(s, 0.0), atol=1e-9)
    assert heading == pytest.approx(lane.heading_at(s), abs=1e-9)


@settings(deadline=None)
@given(row=ROWS, share=SHARES, lateral=LATERALS)
def test_projections_are_those_of_highway_env(row: int, share: float, lateral: float) -> None:
    lane = TOWN.network.get_lane(TOWN.lane_indices[row])
    x, y = lane.position(share * lane.length, lateral)
    expected = lane.local_coordinates(np.array((x, y)))
    np.testing.assert_allclose(lane_project(TOWN.graph, row, x, y), expected, atol=1e-9)


@settings(deadline=None, max_examples=50)
@given(row=ROWS, share=SHARES, lateral=LATERALS, turned=st.floats(-math.pi, math.pi))
def test_closest_lane_is_as_close_as_highway_envs(
    row: int, share: float, lateral: float, turned: float
) -> None:
    lane = TOWN.network.get_lane(TOWN.lane_indices[row])
    position = lane.position(share * lane.length, lateral)
    heading = lane.heading_at(share * lane.length) + turned
    found = TOWN.network.get_lane(TOWN.lane_indices[closest_lane(TOWN.graph, *position, heading)])
    distances = [other.distance_with_heading(position, heading) for other in TOWN.network.lanes_list()]
    assert found.distance_with_heading(position, heading) == pytest.approx(min(distances), abs=1e-9)


@pytest.mark.parametrize(
    "end",
    [
        Pose(20.0, 15.0, math.pi / 2),
        Pose(20.0, -15.0, -math.pi / 2),
        Pose(30.0, 3.5, 0.0),
        Pose(25.0, -2.0, 0.2),
    ],
)
def test_a_join_has_no_jump(end: Pose) -> None:
    pieces = join(Pose(0.0, 0.0, 0.0), end)
    poses = [Pose(0.0, 0.0, 0.0), *(piece.end for piece in pieces)]
    for piece, before in zip(pieces, poses, strict=False):
        assert math.hypot(piece.start.x - before.x, piece.start.y - before.y) < 1e-6
        assert abs(wrap(piece.start.heading - before.heading)) < 1e-9
    assert math.hypot(poses[-1].x - end.x, poses[-1].y - end.y) < 1e-6
    assert abs(wrap(poses[-1].heading - end.heading)) < 1e-9


def test_a_join_that_would_be_too_tight_is_refused() -> None:
    with pytest.raises(ValueError, match="no smooth way"):
        join(Pose(0.0, 0.0, 0.0), Pose(3.0, 3.0, math.pi / 2))


def test_bends_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"radius 60.0 m needs"):
        rounded_polyline([(0.0, 0.0, 0.0), (50.0, 0.0, 60.0), (50.0, 50.0, 0.0)])
