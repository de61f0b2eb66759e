"""The compiled drawing against slow, straightforward NumPy."""

from dataclasses import dataclass

import numpy as np
import pytest
from athrl_driving.errors import DrivingError
from athrl_driving.maps import load_town
from athrl_driving.maps.lane_graph import LaneGraph, Signals
from athrl_driving.perception import Perception, draw_image, drivable_grid, new_perception
from athrl_driving.perception.drivable import draw_drivable_map
from athrl_driving.route import Route
from athrl_driving.traffic.state import Traffic, new_traffic
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

TOWN = load_town("town03")
GRAPH = TOWN.graph
MOST = 12
"""Most vehicles of a moment; unused ones are far away."""

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.sampled_from([32, 64])


@dataclass
class Moment:
    """An ego, the vehicles around it and its route, seen in an image."""

    x: float
    y: float
    heading: float
    traffic: Traffic
    route: Route
    perception: Perception
    size: int = 32
    elevation: float = 0.0

    @property
    def vehicles(self) -> dict[str, NDArray]:
        """Columns of the vehicles that are not far away."""
        background = self.traffic.background
        near = background.x[0] < 1e5
        names = ("x", "y", "heading", "speed", "length", "width", "lane")
        return {name: getattr(background, name)[0][near] for name in names}

    @property
    def ego(self) -> NDArray[np.float64]:
        return np.array([self.x, self.y, self.heading, 5.0, 4.9, 2.1, self.elevation, 1.0])

    def image(self) -> NDArray[np.uint8]:
        return self._drawn()[0]

    def lidar(self) -> NDArray[np.float64]:
        return self._drawn()[1]

    def _drawn(self) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        image = np.full((self.size, self.size, 4), 77, np.uint8)
        distances = np.empty(self.perception.ray_cosine.shape[0])
        draw_image(self.perception, self.traffic, self.route.routes, 0, self.ego, image, distances)
        return image, distances


def traffic_of(**columns: NDArray) -> Traffic:
    """Vehicles with these columns; lengths, widths, speeds and lanes have defaults."""
    traffic = new_traffic(TOWN, 1, MOST)
    background = traffic.background
    background.x[:] = 1e6
    count = columns["x"].size
    background.length[0, :count], background.width[0, :count] = 5.0, 2.0
    for name, values in columns.items():
        getattr(background, name)[0, :count] = values
    return traffic


def moment(seed: int, size: int = 32, **view: float) -> Moment:
    """A random pose near a random lane, with vehicles scattered around it."""
    rng = np.random.default_rng(seed)
    lane = int(rng.integers(GRAPH.length.size))
    route = Route(GRAPH, lane, float(rng.uniform(0, GRAPH.length[lane])), rng)
    x, y, heading = route.poses(np.array([0.0]))[0]
    x, y, heading = x + rng.normal(), y + rng.normal(), heading + rng.normal(scale=0.3)
    count = int(rng.integers(0, MOST))
    traffic = traffic_of(
        x=x + rng.uniform(-30, 30, count),
        y=y + rng.uniform(-30, 30, count),
        heading=rng.uniform(-4, 4, count),
        speed=rng.choice([0.0, 3.0, 8.0, 13.0], count),
        length=rng.uniform(3, 6, count),
        width=rng.uniform(1.5, 2.5, count),
        lane=rng.integers(0, GRAPH.length.size, count),
        elevation=rng.uniform(-2.9, 2.9, count),
    )
    return Moment(x, y, heading, traffic, route, new_perception(TOWN, **view), size)


def pixel_centres(view: Moment) -> tuple[NDArray, NDArray]:
    """Metres ahead and to the right of the ego of each pixel's centre, [size, size] both."""
    side = view.perception.window_side
    offsets = (np.arange(view.size) + 0.5) * side / view.size
    ahead = side - view.perception.ego_above_lower_edge
    return np.meshgrid(ahead - offsets, offsets - side / 2, indexing="ij")


def in_frame(view: Moment, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
    dx, dy = x - view.x, y - view.y
    cosine, sine = np.cos(view.heading), np.sin(view.heading)
    return dx * cosine + dy * sine, dy * cosine - dx * sine


def projected(lane: int, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
    """Metres along and to the right of a lane."""
    heading, curvature = GRAPH.start_heading[lane], GRAPH.curvature[lane]
    dx, dy = x - GRAPH.start_x[lane], y - GRAPH.start_y[lane]
    along, across = dx * np.cos(heading) + dy * np.sin(heading), dy * np.cos(heading) - dx * np.sin(heading)
    if curvature == 0.0:
        return along, across
    # From the circle's centre, which lies `1 / curvature` to the right of the start.
    radius = 1.0 / curvature
    away = np.hypot(along, across - radius)
    return np.arctan2(along * radius, (radius - across) * radius) * radius, radius - np.sign(radius) * away


@settings(max_examples=6, deadline=None)
@given(SEEDS, SIZES)
def test_drivable_map_is_the_lanes_surface(seed: int, size: int) -> None:
    view = moment(seed, size)
    forward, right = pixel_centres(view)
    cosine, sine = np.cos(view.heading), np.sin(view.heading)
    x, y = view.x + forward * cosine - right * sine, view.y + forward * sine + right * cosine
    # The grid's half-metre cells blur the edge by up to 1.1 m on the diagonal.
    inner, outer = np.zeros((size, size), bool), np.zeros((size, size), bool)
    reach = 25.0
    near = np.flatnonzero(
        (GRAPH.box[:, 0] < view.x + reach)
        & (GRAPH.box[:, 2] > view.x - reach)
        & (GRAPH.box[:, 1] < view.y + reach)
        & (GRAPH.box[:, 3] > view.y - reach)
    )
    for lane in near:
        along, across = projected(lane, x, y)
        margin = GRAPH.width[lane] / 2 - np.abs(across)
        inner |= (margin > 1.1) & (along >= 0.0) & (along <= GRAPH.length[lane])
        outer |= (margin > -1.1) & (along >= -1.4) & (along <= GRAPH.length[lane] + 1.4)
    image = view.image()
    assert np.all(image[inner, 0] == 255)
    assert np.all(image[~outer, 0] == 0)


def overpass() -> LaneGraph:
    """Two straight roads that cross at (50, 0): along x on the ground, along y 5 m above it."""
    fields = {name: np.zeros(2, getattr(GRAPH, name).dtype) for name in LaneGraph._fields}
    fields.update(
        start_x=np.array([0.0, 50.0]),
        start_y=np.array([0.0, -50.0]),
        start_heading=np.array([0.0, np.pi / 2]),
        start_cos=np.array([1.0, 0.0]),
        start_sin=np.array([0.0, 1.0]),
        length=np.full(2, 100.0),
        width=np.full(2, 4.0),
        elevation=np.array([0.0, 5.0]),
        box=np.array([[0.0, -2.0, 100.0, 2.0], [48.0, -50.0, 52.0, 50.0]]),
        successor_start=np.zeros(3, np.int64),
        successor=np.zeros(0, np.int64),
    )
    return LaneGraph(**fields)


def test_road_above_is_not_drivable_below_and_the_other_way_round() -> None:
    drivable = draw_drivable_map(overpass())
    view = moment(1)
    view.perception = view.perception._replace(drivable=drivable)
    view.x, view.y, view.heading = 50.0, 0.0, 0.0
    below = view.image()[..., 0]
    view.elevation = 5.0
    above = view.image()[..., 0]
    # Rows lead forward (along x), columns to the right (along y); the ego is at row 19.5, column 15.5.
    assert np.all(below[:, 15:17] == 255)
    assert np.all(below[:, :13] == 0)
    assert np.all(above[19:21, :] == 255)
    assert np.all(above[:17, :] == 0)
    view.elevation = 2.5
    both = view.image()[..., 0]
    np.testing.assert_array_equal(both, np.maximum(below, above))


def test_a_map_high_in_the_mountains_looks_as_one_at_the_sea() -> None:
    """Heights above 3,276 m did not fit into the grid: nothing there was drivable."""
    view, images = moment(1), []
    for base in (0.0, 4000.0, -4000.0):
        lanes = overpass()
        raised = lanes._replace(elevation=lanes.elevation + base)
        view.perception = view.perception._replace(drivable=draw_drivable_map(raised))
        view.x, view.y, view.heading, view.elevation = 50.0, 0.0, 0.0, base
        images.append(view.image()[..., 0])
    assert images[0].any()
    np.testing.assert_array_equal(images[1], images[0])
    np.testing.assert_array_equal(images[2], images[0])


def test_a_map_that_no_picture_can_be_made_of_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    lanes = overpass()
    with pytest.raises(DrivingError, match=r"^the map's lanes lie from 0 to 7,000 m high, at most 6,000 m"):
        draw_drivable_map(lanes._replace(elevation=np.array([0.0, 7000.0])))
    monkeypatch.setattr("athrl_driving.perception.drivable._memory", lambda: 2**18)
    with pytest.raises(DrivingError, match=r"^the map's lanes lie on 0 x 0 km: .+ takes 0 GiB, this machine"):
        draw_drivable_map(lanes)


def test_grid_of_a_town_is_drawn_once() -> None:
    assert drivable_grid(TOWN) is drivable_grid(TOWN)


@settings(max_examples=30, deadline=None)
@given(SEEDS, SIZES, st.sampled_from([{}, {"window_side": 48.0, "ego_above_lower_edge": 24.0}]))
def test_vehicles_and_their_predicted_positions(seed: int, size: int, window: dict[str, float]) -> None:
    view = moment(seed, size, **window)
    forward, right = pixel_centres(view)
    pixel = view.perception.window_side / size
    expected = np.zeros((size, size))
    cars = view.vehicles
    places = zip(*in_frame(view, cars["x"], cars["y"]), strict=True)
    for vehicle, (ahead, aside) in enumerate(places):
        speed = cars["speed"][vehicle]
        angle = cars["heading"][vehicle] - view.heading
        turning = speed * GRAPH.curvature[cars["lane"][vehicle]] * 0.25
        for step in range(9 if speed > 0.2 else 1):
            along = np.abs((forward - ahead) * np.cos(angle) + (right - aside) * np.sin(angle))
            across = np.abs((right - aside) * np.cos(angle) - (forward - ahead) * np.sin(angle))
            covered = np.clip((cars["length"][vehicle] / 2 - along) / pixel + 0.5, 0, 1)
            covered *= np.clip((cars["width"][vehicle] / 2 - across) / pixel + 0.5, 0, 1)
            brightness = 255.0 if step == 0 else 176.0 * (9 - step) / 8
            expected = np.maximum(expected, brightness * covered)
            ahead += speed * 0.25 * np.cos(angle + turning / 2)
            aside += speed * 0.25 * np.sin(angle + turning / 2)
            angle += turning
    np.testing.assert_allclose(view.image()[..., 1], expected, atol=1.0)


@settings(max_examples=20, deadline=None)
@given(SEEDS, SIZES)
def test_route_line_fades_with_the_distance_from_the_route(seed: int, size: int) -> None:
    view = moment(seed, size)
    forward, right = pixel_centres(view)
    positions = np.arange(max(-60.0, view.route.starts[0]), 100.0, 0.02)
    poses = view.route.poses(positions)
    ahead, aside = in_frame(view, poses[:, 0], poses[:, 1])
    # A route that turns back into view from further away is not drawn there.
    is_far = (positions < -25.0) | (positions > 38.0)
    assume(not np.any(is_far & (ahead > -15.0) & (ahead < 23.0) & (np.abs(aside) < 19.0)))
    distance = np.full((size, size), np.inf)
    for point in range(positions.size):
        distance = np.minimum(distance, np.hypot(forward - ahead[point], right - aside[point]))
    expected = 255.0 * np.clip(1.0 - distance * size / 32.0 / 1.5, 0.0, 1.0)
    # Steps of a pixel deviate from an arc by some hundredths of a pixel.
    np.testing.assert_allclose(view.image()[..., 2], expected, atol=6.0)


def test_route_is_half_as_bright_beyond_a_light_that_is_not_green() -> None:
    way = int(np.flatnonzero(GRAPH.movement >= 0)[0])
    origin = int(TOWN.movements.origin[GRAPH.movement[way]])
    start = max(float(GRAPH.length[origin]) - 10.0, 0.0)
    route = Route(GRAPH, origin, start, np.random.default_rng(0))
    x, y, heading = route.poses(np.array([0.0]))[0]
    view = Moment(x, y, heading, traffic_of(x=np.empty(0)), route, new_perception(TOWN))
    plain = view.image()[..., 2].astype(float)
    lights = Signals(*(np.array([value]) for value in (20.0, 5.0, 12.0, 3.0)))
    movements = view.traffic.movements
    view.traffic = view.traffic._replace(
        signals=lights, movements=movements._replace(signal=np.zeros_like(movements.signal))
    )
    seen = {}
    for clock in (4.0, 6.0, 13.0, 16.0, 26.0):
        view.traffic.scratch.clock[0] = clock
        seen[clock] = view.image()[..., 2]
    for green in (6.0, 26.0):
        np.testing.assert_array_equal(seen[green], plain)
    forward, _ = pixel_centres(view)
    line = float(GRAPH.length[origin]) - start
    for held_up in (4.0, 13.0, 16.0):
        before, beyond = forward < line - 2.0, forward > line + 2.0
        np.testing.assert_array_equal(seen[held_up][before], plain[before])
        np.testing.assert_allclose(seen[held_up][beyond], 0.5 * plain[beyond], atol=1.0)
        assert seen[held_up][beyond].max() > 100


def crossings(x: float, y: float, angle: float, corners: NDArray) -> float:
    """Metres along a ray to the nearest edge of a polygon [4, 2], inf where it misses."""
    nearest = np.inf
    direction = np.array([np.cos(angle), np.sin(angle)])
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        matrix = np.column_stack([direction, start - end])
        if abs(np.linalg.det(matrix)) < 1e-12:
            continue
        along, share = np.linalg.solve(matrix, start - np.array([x, y]))
        if along >= 0 and 0 <= share <= 1:
            nearest = min(nearest, along)
    return nearest


@settings(max_examples=10, deadline=None)
@given(SEEDS, st.sampled_from([(180, 40.0), (72, 25.0)]))
def test_lidar_rays_end_on_the_first_vehicle(seed: int, lidar: tuple[int, float]) -> None:
    rays, reach = lidar
    view = moment(seed, lidar_rays=rays, lidar_range=reach)
    background = view.traffic.background
    # A ray that starts inside a vehicle has no edge to end at.
    background.x[0][np.hypot(background.x[0] - view.x, background.y[0] - view.y) < 5.0] = 1e6
    cars = view.vehicles
    expected = np.full(rays, np.inf)
    columns = (cars[name] for name in ("x", "y", "heading", "length", "width"))
    for x, y, heading, length, width in zip(*columns, strict=True):
        corners = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) / 2 * [length, width]
        rotation = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        corners = corners @ rotation + [x, y]
        for ray in range(rays):
            angle = view.heading + ray * 2 * np.pi / rays
            expected[ray] = min(expected[ray], crossings(view.x, view.y, angle, corners))
    expected[expected > reach] = np.inf
    np.testing.assert_allclose(view.lidar(), expected, atol=1e-6)


def beside(x: NDArray, y: float = 0.0, **columns: NDArray) -> Moment:
    """An ego at the origin heading along x, and standing cars heading the same way."""
    route = Route(GRAPH, 0, 0.0, np.random.default_rng(0))
    traffic = traffic_of(x=x, y=np.full(x.size, y), **columns)
    return Moment(0.0, 0.0, 0.0, traffic, route, new_perception(TOWN))


def test_lidar_does_not_see_behind_a_vehicle() -> None:
    both = beside(np.array([8.0, 16.0])).lidar()
    assert both[0] == 5.5
    np.testing.assert_array_equal(both, beside(np.array([8.0])).lidar())


def test_vehicles_on_another_level_are_not_seen() -> None:
    for height, seen in ((2.9, True), (-2.9, True), (3.1, False), (-3.1, False)):
        view = beside(np.array([8.0]), elevation=np.array([height]))
        assert bool(view.image()[..., 1].any()) == seen
        assert bool(np.isfinite(view.lidar()).any()) == seen


@settings(max_examples=30, deadline=None)
@given(SEEDS, SIZES)
def test_lidar_channel_shows_where_rays_ended(seed: int, size: int) -> None:
    view = moment(seed, size)
    distances = view.lidar()
    hit = np.isfinite(distances)
    angles = np.arange(distances.size)[hit] * 2 * np.pi / distances.size
    rows = np.floor((20.0 - distances[hit] * np.cos(angles)) * size / 32.0).astype(int)
    columns = np.floor((16.0 + distances[hit] * np.sin(angles)) * size / 32.0).astype(int)
    inside = (rows >= 0) & (rows < size) & (columns >= 0) & (columns < size)
    expected = np.zeros((size, size), np.uint8)
    expected[rows[inside], columns[inside]] = 255
    # A ray that ends on the border of two pixels may be rounded to either.
    assert np.count_nonzero(view.image()[..., 3] != expected) <= 2


def test_left_of_the_image_is_the_drivers_left_and_up_is_ahead() -> None:
    for heading in (0.0, 1.0, -2.0):
        ahead, right = (np.cos(heading), np.sin(heading)), (-np.sin(heading), np.cos(heading))
        x, y = 10.0 * ahead[0] - 6.0 * right[0], 10.0 * ahead[1] - 6.0 * right[1]
        view = beside(np.array([x]), y, heading=np.array([heading]), length=np.array([4.0]))
        view.heading = heading
        rows, columns = np.nonzero(view.image()[..., 1])
        assert rows.mean() == 9.5  # 10 m ahead: 20 m is the upper edge
        assert columns.mean() == 9.5  # 6 m to the left of the middle


def test_a_vehicles_prediction_shows_direction_and_speed() -> None:
    straight = int(np.flatnonzero(GRAPH.curvature == 0)[0])

    def shade(heading: float, speed: float) -> NDArray:
        view = beside(
            np.array([4.0]), heading=np.array([heading]), speed=np.array([speed]), lane=np.array([straight])
        )
        return view.image()[..., 1]

    standing, away, towards = shade(0.0, 0.0), shade(0.0, 6.0), shade(np.pi, 6.0)
    body = standing == 255
    assert np.all(away[body] == 255)
    assert away[:12].sum() > 0
    assert away[20:].sum() == 0
    assert towards[20:].sum() > 0
    assert towards[:11].sum() == 0
    assert np.count_nonzero(shade(0.0, 3.0)) < np.count_nonzero(away)


@pytest.mark.parametrize(
    ("setting", "value"),
    [("window_side", 0.0), ("ego_above_lower_edge", 33.0), ("lidar_range", -1.0), ("lidar_rays", 0)],
)
def test_an_invalid_setting_is_named(setting: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"the setting {setting} is {value}, it should be"):
        new_perception(TOWN, **{setting: value})
