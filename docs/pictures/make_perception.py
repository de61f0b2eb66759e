"""Draws what the planner sees beside the scene: run `python docs/pictures/make_perception.py`."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from athrl_driving.drivers import RuleBasedDriver
from athrl_driving.envs import TownEnv
from athrl_driving.perception import CHANNELS, EGO_ABOVE_LOWER_EDGE, WINDOW_SIDE
from athrl_driving.scenarios import SCENARIOS
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from numpy.typing import NDArray

FOLDER = Path(__file__).parent
SIZE = 32
SEED, DECISIONS = 5, 67
"""The moment that is drawn: in the roundabout, vehicles in front, beside and coming."""

_ROAD, _MARK, _OTHER, _EGO, _ROUTE = "#d5d8dc", "#aab0b7", "#33557a", "#c8442e", "#2e9e6b"


def seen_moment() -> TownEnv:
    """Drive the case study of the roundabout up to the moment."""
    env = TownEnv(config={**SCENARIOS["athrl/Roundabout-v0"], "vehicles_count": 40, "image_size": SIZE})
    env.reset(seed=SEED)
    driver = RuleBasedDriver()
    for _ in range(DECISIONS):
        env.step(driver.act(env))
    return env


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


def draw_scene(env: TownEnv, axes: Axes) -> None:
    """Lanes, vehicles and route from above, heading up, and the window's border."""
    graph = env.town.graph
    for line, width in zip(env.town.lane_polylines(1.0), graph.width, strict=True):
        heading = np.arctan2(*np.gradient(line, axis=0).T[::-1])
        aside = 0.5 * width * np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        outline = np.concatenate([line + aside, (line - aside)[::-1]])
        axes.add_patch(Polygon(in_frame(env, outline), color=_ROAD, linewidth=0))
    for line, width in zip(env.town.lane_polylines(1.0), graph.width, strict=True):
        heading = np.arctan2(*np.gradient(line, axis=0).T[::-1])
        aside = 0.5 * width * np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        for border in (line + aside, line - aside):
            axes.plot(*in_frame(env, border).T, color=_MARK, linewidth=0.4)
    route = env.route
    way = route.poses(np.arange(max(route.position - 15.0, route.starts[0]), route.position + 60.0, 0.5))
    axes.plot(*in_frame(env, way[:, :2]).T, color=_ROUTE, linewidth=1.6)
    axes.plot(*in_frame(env, route.waypoints()[:, :2]).T, "o", color=_ROUTE, markersize=3)
    others = env.road.background
    columns = (others.x, others.y, others.heading, others.length, others.width)
    for vehicle in zip(*columns, strict=True):
        axes.add_patch(Polygon(in_frame(env, body(*vehicle)), color=_OTHER))
    ego = env.vehicle
    corners = body(*ego.position, ego.heading, ego.LENGTH, ego.WIDTH)
    axes.add_patch(Polygon(in_frame(env, corners), color=_EGO))
    half = WINDOW_SIDE / 2
    window = [(-half, -EGO_ABOVE_LOWER_EDGE), (half, WINDOW_SIDE - EGO_ABOVE_LOWER_EDGE)]
    axes.add_patch(plt.Rectangle(window[0], WINDOW_SIDE, WINDOW_SIDE, fill=False, color="black", linewidth=1))
    axes.set(xlim=(-26, 26), ylim=(-22, 30), aspect="equal")
    axes.set_xticks([])
    axes.set_yticks([])


def main() -> None:
    """Write the scene, a picture of each channel and all of them in one."""
    env = seen_moment()
    image = env.observation_type.observe()["image"]
    figure, places = plt.subplots(1, 5, figsize=(15, 3.35), layout="constrained")
    draw_scene(env, places[0])
    places[0].set_title("scene (the square is the window)", fontsize=10)
    for channel, name in enumerate(CHANNELS):
        axes = places[channel + 1]
        axes.imshow(image[..., channel], cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        axes.set_title(f"{channel}: {name}", fontsize=10)
        axes.set_xticks([])
        axes.set_yticks([])
        large = np.kron(image[..., channel], np.ones((8, 8), dtype=np.uint8))
        plt.imsave(FOLDER / f"channel-{name}.png", large, cmap="gray", vmin=0, vmax=255)
    figure.savefig(FOLDER / "perception.png", dpi=110)


if __name__ == "__main__":
    main()
