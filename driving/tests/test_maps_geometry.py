"""The compiled geometry is highway-env's."""

import math

import numpy as np
import pytest
from athrl_driving.maps import closest_lane, lane_pose, lane_project, load_town
from hypothesis import given, settings
from hypothesis import strategies as st

TOWN = load_town("town03")
LANES = st.integers(0, len(TOWN.graph.length) - 1)
SHARES = st.floats(0.0, 1.0)
LATERALS = st.floats(-6.0, 6.0)


@settings(deadline=None)
@given(lane_id=LANES, share=SHARES)
def test_poses_are_those_of_highway_env(lane_id: int, share: float) -> None:
    lane = TOWN.network.get_lane(TOWN.lane_indices[lane_id])
    s = share * lane.length
    x, y, heading = lane_pose(TOWN.graph, lane_id, s)
    assert lane.length == pytest.approx(TOWN.graph.length[lane_id], abs=1e-9)
    np.testing.assert_allclose((x, y), lane.position(s, 0.0), atol=1e-9)
    assert heading == pytest.approx(lane.heading_at(s), abs=1e-9)


@settings(deadline=None)
@given(lane_id=LANES, share=SHARES, lateral=LATERALS)
def test_projections_are_those_of_highway_env(lane_id: int, share: float, lateral: float) -> None:
    lane = TOWN.network.get_lane(TOWN.lane_indices[lane_id])
    x, y = lane.position(share * lane.length, lateral)
    expected = lane.local_coordinates(np.array((x, y)))
    np.testing.assert_allclose(lane_project(TOWN.graph, lane_id, x, y), expected, atol=1e-9)


@settings(deadline=None, max_examples=50)
@given(lane_id=LANES, share=SHARES, lateral=LATERALS, turned=st.floats(-math.pi, math.pi))
def test_closest_lane_is_as_close_as_highway_envs(
    lane_id: int, share: float, lateral: float, turned: float
) -> None:
    lane = TOWN.network.get_lane(TOWN.lane_indices[lane_id])
    position = lane.position(share * lane.length, lateral)
    heading = lane.heading_at(share * lane.length) + turned
    found = TOWN.network.get_lane(TOWN.lane_indices[closest_lane(TOWN.graph, *position, heading)])
    distances = [other.distance_with_heading(position, heading) for other in TOWN.network.lanes_list()]
    assert found.distance_with_heading(position, heading) == pytest.approx(min(distances), abs=1e-9)
