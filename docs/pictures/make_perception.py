"""Draws what the planner sees beside the scene: run `python docs/pictures/make_perception.py`.

Nothing is left to chance: of some episodes, always the same ones, the moment that shows most is drawn.
Another version of the traffic or of the driver has another such moment.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from athrl_driving.drivers import RuleBasedDriver
from athrl_driving.envs import TownEnv
from athrl_driving.maps.levels import ROAD_LEVEL_HEIGHT
from athrl_driving.perception import EGO_ABOVE_LOWER_EDGE, WINDOW_SIDE
from athrl_driving.scenarios import SCENARIOS
from athrl_spaces import CHANNELS
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.patches import Polygon, Rectangle
from numpy.typing import NDArray

FOLDER = Path(__file__).parent
DRIVABLE, VEHICLES, ROUTE, LIDAR = range(len(CHANNELS))
SEEDS = 12
"""Episodes that are looked through."""

ROUNDABOUT = {**SCENARIOS["athrl/Roundabout-v0"], "vehicles_count": 45}
"""Into the ring, through it and out."""

RED_LIGHT = {
    "town": "town04",
    "start": ("b3 - c3", -1, 60.0),
    "destination": ("c3 - d3", -1, 20.0),
    "traffic_near": (0.0, 0.0, 200.0),
    "vehicles_count": 40,
}
"""Straight on through a crossing with lights."""

_ROAD, _MARK, _OTHER, _EGO, _WAY, _STOP = "#d5d8dc", "#aab0b7", "#33557a", "#c8442e", "#2e9e6b", "#e0322b"
_SHADES = LinearSegmentedColormap.from_list("shades", ["#22374d", "#ffffff"])
"""From 0 to 255: less black, so that what is faint is seen."""


def moments(settings: dict) -> Iterator[TownEnv]:
    """Yield the environment at every decision of the rule-based driver."""
    env, driver = TownEnv(config=settings), RuleBasedDriver()
    for seed in range(SEEDS):
        env.reset(seed=seed)
        driver.reset(env, seed)
        ended = False
        while not ended:
            *_, terminated, truncated, _ = env.step(driver.act(env))
            ended = terminated or truncated
            yield env


def most_telling(settings: dict, wanted: Callable[[TownEnv], bool]) -> TownEnv:
    """The first of the `wanted` moments that shows most."""
    best, most = None, -1.0
    for env in moments(settings):
        value = telling(seen(env))
        if value > most and wanted(env):
            best, most = copy.deepcopy(env), value
    if best is None:
        raise RuntimeError(f"no moment like that in {SEEDS} episodes of {settings}")
    return best


def seen(env: TownEnv) -> NDArray[np.uint8]:
    """The image, uint8 [32, 32, 4]."""
    image: NDArray[np.uint8] = env.observation_type.observe()["image"]
    return image


def telling(image: NDArray[np.uint8]) -> float:
    """Pixels of bodies, of trails and of the lidar; what is ahead counts most."""
    weight = np.where(np.arange(len(image)) < 0.6 * len(image), 1.0, 0.5)[:, None]
    vehicles = image[..., VEHICLES]
    faded = (vehicles > 10) & (vehicles < 180)
    return float(np.sum(weight * ((vehicles > 200) + 0.5 * faded + 2.0 * (image[..., LIDAR] > 0))))


def is_in_the_ring(env: TownEnv) -> bool:
    """Whether the ego drives in the roundabout of town03."""
    return bool(np.hypot(*env.vehicle.position) < 26.0 and env.vehicle.speed > 3.0)


def waits_for_green(env: TownEnv) -> bool:
    """Whether the ego stands and the route ahead has half its brightness."""
    return bool(seen(env)[:4, :, ROUTE].max() < 160 and env.vehicle.speed < 0.5)


def in_frame(env: TownEnv, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """[n, 2] metres to the right and ahead of the ego of points [n, 2] in the town."""
    ego = env.vehicle
    cosine, sine = math.cos(ego.heading), math.sin(ego.heading)
    dx, dy = (points - ego.position).T
    return np.stack([dy * cosine - dx * sine, dx * cosine + dy * sine], axis=1)


def body(x: float, y: float, heading: float, length: float, width: float) -> NDArray[np.float64]:
    """[4, 2] corners of a vehicle, m."""
    cosine, sine = math.cos(heading), math.sin(heading)
    corners = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * [length / 2, width / 2]
    return corners @ np.array([[cosine, sine], [-sine, cosine]]) + [x, y]


def draw_lanes(env: TownEnv, axes: Axes) -> None:
    """The lanes on the ego's level, with their borders."""
    graph = env.town.graph
    level = np.abs(graph.elevation - env.vehicle.elevation) <= ROAD_LEVEL_HEIGHT
    borders = []
    for line, width, seen in zip(env.town.lane_polylines(1.0), graph.width, level, strict=True):
        if seen:
            heading = np.arctan2(*np.gradient(line, axis=0).T[::-1])
            aside = 0.5 * width * np.stack([-np.sin(heading), np.cos(heading)], axis=1)
            outline = np.concatenate([line + aside, (line - aside)[::-1]])
            axes.add_patch(Polygon(in_frame(env, outline), color=_ROAD, linewidth=0))
            borders += [line + aside, line - aside]
    for border in borders:
        axes.plot(*in_frame(env, border).T, color=_MARK, linewidth=0.4)


def draw_way(env: TownEnv, axes: Axes) -> None:
    """The route and its waypoints."""
    route = env.route
    begin = max(route.position - 15.0, route.starts[0])
    way = route.poses(np.arange(begin, route.position + 60.0, 0.5))
    axes.plot(*in_frame(env, way[:, :2]).T, color=_WAY, linewidth=1.6)
    axes.plot(*in_frame(env, route.waypoints()[:, :2]).T, "o", color=_WAY, markersize=3)


def draw_scene(env: TownEnv, axes: Axes, red: bool) -> None:
    """Lanes, vehicles and route from above, heading up, and the window's border."""
    draw_lanes(env, axes)
    draw_way(env, axes)
    others, ego = env.road.background, env.vehicle
    columns = (others.x, others.y, others.heading, others.length, others.width)
    for vehicle in zip(*columns, strict=True):
        axes.add_patch(Polygon(in_frame(env, body(*vehicle)), color=_OTHER))
    x, y = ego.position.tolist()
    corners = body(x, y, ego.heading, ego.LENGTH, ego.WIDTH)
    axes.add_patch(Polygon(in_frame(env, corners), color=_EGO))
    if red:
        ahead = 0.5 * ego.LENGTH + env.road.ego_stop_line()
        axes.plot([-1.75, 1.75], [ahead, ahead], color=_STOP, linewidth=3)
    corner = (-WINDOW_SIDE / 2, -EGO_ABOVE_LOWER_EDGE)
    axes.add_patch(Rectangle(corner, WINDOW_SIDE, WINDOW_SIDE, fill=False, color="black", linewidth=1))
    axes.set(xlim=(-26, 26), ylim=(-22, 30), aspect="equal")


def draw_channel(image: NDArray[np.uint8], channel: int, axes: Axes) -> None:
    """One channel in metres, with the ego's outline."""
    half, below = WINDOW_SIDE / 2, EGO_ABOVE_LOWER_EDGE
    extent = (-half, half, -below, WINDOW_SIDE - below)
    axes.imshow(image[..., channel], cmap=_SHADES, vmin=0, vmax=255, extent=extent, interpolation="nearest")
    axes.add_patch(Polygon(body(0.0, 0.0, math.pi / 2, 4.9, 2.1), fill=False, color=_EGO, linewidth=1.2))


def draw_moment(env: TownEnv, channels: tuple[int, ...], red: bool, path: Path) -> None:
    """The scene and beside it some channels."""
    image = seen(env)
    size = (3 * (1 + len(channels)), 3.3)
    figure, places = plt.subplots(1, 1 + len(channels), figsize=size, layout="constrained")
    draw_scene(env, places[0], red)
    places[0].set_title("scene (the square is the window)", fontsize=10)
    for axes, channel in zip(places[1:], channels, strict=True):
        draw_channel(image, channel, axes)
        axes.set_title(f"{channel}: {CHANNELS[channel]}", fontsize=10)
    for axes in places:
        axes.set_xticks([])
        axes.set_yticks([])
    figure.savefig(path, dpi=110, metadata={"Software": None})


def write_channel(image: NDArray[np.uint8], channel: int) -> None:
    """A picture of one channel alone."""
    large = np.kron(image[..., channel], np.ones((8, 8), dtype=np.uint8))
    path = FOLDER / f"channel-{CHANNELS[channel]}.png"
    plt.imsave(path, large, cmap=_SHADES, vmin=0, vmax=255, metadata={"Software": None})


def main() -> None:
    """Write a roundabout with all channels, each channel alone, and a crossing at a red light."""
    ring = most_telling(ROUNDABOUT, is_in_the_ring)
    draw_moment(ring, (DRIVABLE, VEHICLES, ROUTE, LIDAR), False, FOLDER / "perception.png")
    for channel in range(len(CHANNELS)):
        write_channel(seen(ring), channel)
    crossing = most_telling(RED_LIGHT, waits_for_green)
    draw_moment(crossing, (VEHICLES, ROUTE), True, FOLDER / "red-light.png")


if __name__ == "__main__":
    main()
