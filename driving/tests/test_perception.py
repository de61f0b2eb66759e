"""The compiled drawing against slow, straightforward NumPy."""

from dataclasses import dataclass

import numpy as np
from athrl_driving.maps import lane_project, load_town
from athrl_driving.perception import Perception, drivable_map
from athrl_driving.perception.lidar import LIDAR_RANGE, RAYS, lidar_distances
from athrl_driving.route import Route
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

TOWN = load_town("town03")
GRAPH = TOWN.graph


@dataclass
class Vehicles:
    x: NDArray
    y: NDArray
    heading: NDArray
    speed: NDArray
    length: NDArray
    width: NDArray
    lane: NDArray


@dataclass
class Moment:
    size: int
    x: float
    y: float
    heading: float
    vehicles: Vehicles
    route: Route
    image: NDArray[np.uint8]


def moment(seed: int, size: int = 32) -> Moment:
    """A random pose near a random lane, with vehicles scattered around it."""
    rng = np.random.default_rng(seed)
    lane = int(rng.integers(GRAPH.length.size))
    route = Route(GRAPH, lane, float(rng.uniform(0, GRAPH.length[lane])), rng)
    x, y, heading = route.poses(np.array([0.0]))[0]
    x, y, heading = x + rng.normal(), y + rng.normal(), heading + rng.normal(scale=0.3)
    count = int(rng.integers(0, 12))
    vehicles = Vehicles(
        x=x + rng.uniform(-30, 30, count),
        y=y + rng.uniform(-30, 30, count),
        heading=rng.uniform(-4, 4, count),
        speed=rng.choice([0.0, 3.0, 8.0, 13.0], count),
        length=rng.uniform(3, 6, count),
        width=rng.uniform(1.5, 2.5, count),
        lane=rng.integers(0, GRAPH.length.size, count),
    )
    image = Perception(drivable_map("town03"), GRAPH, size).observe(x, y, heading, vehicles, route)
    assert image.shape == (size, size, 4)
    assert image.dtype == np.uint8
    return Moment(size, x, y, heading, vehicles, route, image)


def pixel_centres(view: Moment) -> tuple[NDArray, NDArray]:
    """Metres ahead and to the right of the ego of each pixel's centre, [size, size] both."""
    offsets = (np.arange(view.size) + 0.5) * 32.0 / view.size
    return np.meshgrid(20.0 - offsets, offsets - 16.0, indexing="ij")


def in_frame(view: Moment, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
    dx, dy = x - view.x, y - view.y
    cosine, sine = np.cos(view.heading), np.sin(view.heading)
    return dx * cosine + dy * sine, dy * cosine - dx * sine


SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.sampled_from([32, 64])


@settings(max_examples=8, deadline=None)
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
        for row in range(size):
            for column in range(size):
                along, across = lane_project(GRAPH, lane, x[row, column], y[row, column])
                margin = GRAPH.width[lane] / 2 - abs(across)
                inner[row, column] |= margin > 1.1 and 0.0 <= along <= GRAPH.length[lane]
                outer[row, column] |= margin > -1.1 and -1.4 <= along <= GRAPH.length[lane] + 1.4
    assert np.all(view.image[inner, 0] == 255)
    assert np.all(view.image[~outer, 0] == 0)


@settings(max_examples=40, deadline=None)
@given(SEEDS, SIZES)
def test_vehicles_and_where_they_will_be(seed: int, size: int) -> None:
    view = moment(seed, size)
    forward, right = pixel_centres(view)
    pixel = 32.0 / size
    expected = np.zeros((size, size))
    cars = view.vehicles
    places = zip(*in_frame(view, cars.x, cars.y), strict=True)
    for vehicle, (ahead, aside) in enumerate(places):
        angle = cars.heading[vehicle] - view.heading
        turning = cars.speed[vehicle] * GRAPH.curvature[cars.lane[vehicle]] * 0.25
        for step in range(9 if cars.speed[vehicle] > 0.2 else 1):
            along = np.abs((forward - ahead) * np.cos(angle) + (right - aside) * np.sin(angle))
            across = np.abs((right - aside) * np.cos(angle) - (forward - ahead) * np.sin(angle))
            covered = np.clip((cars.length[vehicle] / 2 - along) / pixel + 0.5, 0, 1)
            covered *= np.clip((cars.width[vehicle] / 2 - across) / pixel + 0.5, 0, 1)
            brightness = 255.0 if step == 0 else 176.0 * (9 - step) / 8
            expected = np.maximum(expected, brightness * covered)
            ahead += cars.speed[vehicle] * 0.25 * np.cos(angle + turning / 2)
            aside += cars.speed[vehicle] * 0.25 * np.sin(angle + turning / 2)
            angle += turning
    np.testing.assert_allclose(view.image[..., 1], expected, atol=1.0)


@settings(max_examples=30, deadline=None)
@given(SEEDS, SIZES)
def test_route_line_fades_with_the_distance_from_the_route(seed: int, size: int) -> None:
    view = moment(seed, size)
    forward, right = pixel_centres(view)
    positions = np.arange(max(-20.0, view.route.starts[0]), 36.0, 0.05)
    poses = view.route.poses(positions)
    ahead, aside = in_frame(view, poses[:, 0], poses[:, 1])
    distance = np.full((size, size), np.inf)
    for point in range(positions.size):
        distance = np.minimum(distance, np.hypot(forward - ahead[point], right - aside[point]))
    expected = 255.0 * np.clip(1.0 - distance * size / 32.0 / 1.5, 0.0, 1.0)
    # The line is drawn through points half a pixel apart: a pixel is up to a quarter off the nearest.
    np.testing.assert_allclose(view.image[..., 2], expected, atol=255.0 * 0.25 / 1.5 + 1)
    assert np.abs(view.image[..., 2] - expected).mean() < 1.0


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


@settings(max_examples=15, deadline=None)
@given(SEEDS)
def test_lidar_rays_end_on_the_first_vehicle(seed: int) -> None:
    view = moment(seed)
    cars = view.vehicles
    apart = np.hypot(cars.x - view.x, cars.y - view.y) > 5.0
    columns = (cars.x, cars.y, cars.heading, cars.length, cars.width)
    distances = lidar_distances(view.x, view.y, view.heading, *(column[apart] for column in columns))
    expected = np.full(RAYS, np.inf)
    for x, y, heading, length, width in zip(*(column[apart] for column in columns), strict=True):
        corners = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) / 2 * [length, width]
        rotation = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
        corners = corners @ rotation + [x, y]
        for ray in range(RAYS):
            angle = view.heading + ray * 2 * np.pi / RAYS
            expected[ray] = min(expected[ray], crossings(view.x, view.y, angle, corners))
    expected[expected > LIDAR_RANGE] = np.inf
    np.testing.assert_allclose(distances, expected, atol=1e-6)


def two_cars_in_a_row(gap: float) -> Vehicles:
    """Two cars straight ahead (along x) of an ego at the origin, one behind the other."""
    x = np.array([8.0, 8.0 + gap])
    zeros = np.zeros(2)
    return Vehicles(x, zeros, zeros, zeros, np.full(2, 5.0), np.full(2, 2.0), np.zeros(2, dtype=np.int64))


def test_lidar_does_not_see_behind_a_vehicle() -> None:
    cars = two_cars_in_a_row(8.0)
    both = lidar_distances(0.0, 0.0, 0.0, cars.x, cars.y, cars.heading, cars.length, cars.width)
    assert both[0] == 5.5
    near = lidar_distances(
        0.0, 0.0, 0.0, cars.x[:1], cars.y[:1], cars.heading[:1], cars.length[:1], cars.width[:1]
    )
    np.testing.assert_array_equal(both, near)


@settings(max_examples=40, deadline=None)
@given(SEEDS, SIZES)
def test_lidar_channel_shows_where_rays_ended(seed: int, size: int) -> None:
    view = moment(seed, size)
    cars = view.vehicles
    distances = lidar_distances(
        view.x, view.y, view.heading, cars.x, cars.y, cars.heading, cars.length, cars.width
    )
    hit = np.isfinite(distances)
    angles = np.arange(RAYS)[hit] * 2 * np.pi / RAYS
    rows = np.floor((20.0 - distances[hit] * np.cos(angles)) * size / 32.0).astype(int)
    columns = np.floor((16.0 + distances[hit] * np.sin(angles)) * size / 32.0).astype(int)
    inside = (rows >= 0) & (rows < size) & (columns >= 0) & (columns < size)
    expected = np.zeros((size, size), np.uint8)
    expected[rows[inside], columns[inside]] = 255
    # A ray that ends on the border of two pixels may be rounded to either.
    assert np.count_nonzero(view.image[..., 3] != expected) <= 2


def test_left_of_the_image_is_the_drivers_left_and_up_is_ahead() -> None:
    route = Route(GRAPH, 0, 0.0, np.random.default_rng(0))
    one = np.zeros(1)
    for heading in (0.0, 1.0, -2.0):
        ahead, right = (np.cos(heading), np.sin(heading)), (-np.sin(heading), np.cos(heading))
        x, y = 10.0 * ahead[0] - 6.0 * right[0], 10.0 * ahead[1] - 6.0 * right[1]
        car = Vehicles(
            one + x, one + y, one + heading, one, one + 4.0, one + 2.0, np.zeros(1, dtype=np.int64)
        )
        image = Perception(drivable_map("town03"), GRAPH, 32).observe(0.0, 0.0, heading, car, route)
        rows, columns = np.nonzero(image[..., 1])
        assert rows.mean() == 9.5  # 10 m ahead: 20 m is the upper edge
        assert columns.mean() == 9.5  # 6 m to the left of the middle


def test_a_vehicles_way_ahead_tells_direction_and_speed() -> None:
    route = Route(GRAPH, 0, 0.0, np.random.default_rng(0))
    straight = int(np.flatnonzero(GRAPH.curvature == 0)[0])

    def shade(heading: float, speed: float) -> NDArray:
        one = np.zeros(1)
        car = Vehicles(one + 4.0, one, one + heading, one + speed, one + 5.0, one + 2.0, np.full(1, straight))
        return Perception(drivable_map("town03"), GRAPH, 32).observe(0.0, 0.0, 0.0, car, route)[..., 1]

    standing, away, towards = shade(0.0, 0.0), shade(0.0, 6.0), shade(np.pi, 6.0)
    body = standing == 255
    assert np.all(away[body] == 255)
    assert away[:12].sum() > 0
    assert away[20:].sum() == 0
    assert towards[20:].sum() > 0
    assert towards[:11].sum() == 0
    assert np.count_nonzero(shade(0.0, 3.0)) < np.count_nonzero(away)
