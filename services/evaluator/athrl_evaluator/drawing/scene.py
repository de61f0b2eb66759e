"""Logs frames to a rerun stream."""

from __future__ import annotations

import logging
import math
from collections.abc import Collection, Mapping

import numpy as np
import rerun as rr
from athrl_driving import lane_polylines
from athrl_driving.errors import DrivingError
from athrl_protocol import Frame

from athrl_evaluator.drawing import colours
from athrl_evaluator.drawing.blueprint import INTENTION, TIMELINE, curves_of_decision, make_blueprint
from athrl_evaluator.drawing.shapes import (
    CarPicture,
    bodies_of,
    outlines_of,
    painted,
    points_of,
    windscreens_of,
)

APPLICATION = "athrl"
NEAR = 60.0  # m; anything farther from the car is not drawn
LANE_RADIUS, ROAD_RADIUS = 0.08, 1.9  # m; half the width of lines
PAUSE = 1.0  # simulated seconds between two episodes on the timeline
LONGEST_TIMELINE = 1e9  # simulated seconds, after which it begins again: rerun counts nanoseconds in 64 bits
MOST_CURVES = 32  # of decided values; frames from elsewhere may have new names for ever
MOST_TOWNS = 32  # that are loaded for one viewer

log = logging.getLogger(__name__)


class SceneDrawing:
    """Draws one episode after another on one timeline, which continues where the last episode ended.

    Args:
        stream: where to.
        towns: whose roads are drawn; None: of every town that can be loaded. Frames may name any map.
    """

    def __init__(self, stream: rr.RecordingStream, towns: Collection[str] | None = None) -> None:
        self._stream = stream
        self._towns = towns
        self._roads: dict[str, list[np.ndarray]] = {}
        self._town = ""
        self._lanes: list[np.ndarray] = []
        self._offset = 0.0
        self._last_time = -math.inf
        self._episode: tuple[str, int, int] | None = None
        self._laid_out: list[str] = []

    def draw(self, frame: Frame) -> None:
        """Log everything about one frame."""
        self._begin_episode_if_new(frame)
        self._lay_out_decision(frame)
        self._stream.set_time(TIMELINE, duration=self._offset + frame.time)
        self._last_time = frame.time
        if frame.town != self._town:
            self._draw_town(frame.town)
        self._draw_in_town(frame)
        self._draw_around_car(frame)
        self._draw_images(frame)
        self._draw_curves(frame)
        self._stream.log("episode", rr.TextDocument(_caption(frame), media_type=rr.MediaType.MARKDOWN))

    def _begin_episode_if_new(self, frame: Frame) -> None:
        """Place frames of another episode, or of a repetition of this one, later on the timeline."""
        episode = (frame.driver, frame.policy_version, frame.episode_seed)
        if self._episode is not None and (episode != self._episode or frame.time <= self._last_time):
            self._offset += max(0.0, self._last_time) + PAUSE - frame.time
        if self._offset > LONGEST_TIMELINE:
            self._offset = 0.0
        self._episode = episode

    def _lay_out_decision(self, frame: Frame) -> None:
        """Add a view for each curve of the decision; a layout that has them all is not sent again."""
        curves = dict.fromkeys([*self._laid_out, *curves_of_decision(frame.decision)])
        wanted = list(curves)[:MOST_CURVES]
        if wanted != self._laid_out:
            self._laid_out = wanted
            self._stream.send_blueprint(make_blueprint(self._laid_out))

    def _draw_town(self, town: str) -> None:
        self._town = town
        self._lanes = self._roads_of(town)
        radius = rr.Radius.ui_points(1.0)
        roads = rr.LineStrips2D(self._lanes, colors=[colours.TOWN_ROAD], radii=[radius], draw_order=0)
        self._stream.log("town/lanes", roads, static=True)

    def _roads_of(self, town: str) -> list[np.ndarray]:
        """Return the lanes of a town; none of one that may not or cannot be loaded."""
        if town in self._roads:
            return self._roads[town]
        if len(self._roads) >= MOST_TOWNS or (self._towns is not None and town not in self._towns):
            return []
        try:
            self._roads[town] = lane_polylines(town)
        except DrivingError as error:
            log.warning("the roads of %s are not drawn: %s", town, error)
            self._roads[town] = []
        return self._roads[town]

    def _draw_in_town(self, frame: Frame) -> None:
        dot, large_dot, line = (rr.Radius.ui_points(points) for points in (2.5, 5.0, 1.5))
        others = np.array([(each.x, each.y) for each in frame.vehicles]).reshape(-1, 2)
        vehicles = rr.Points2D(others, colors=[colours.VEHICLE], radii=[dot], draw_order=2)
        self._stream.log("town/vehicles", vehicles)
        route = rr.LineStrips2D([points_of(frame.route)], colors=[colours.ROUTE], radii=[line], draw_order=1)
        self._stream.log("town/route", route)
        place = [(frame.ego.x, frame.ego.y)]
        ego = rr.Points2D(place, colors=[colours.EGO], radii=[large_dot], draw_order=3)
        self._stream.log("town/ego", ego)

    def _draw_around_car(self, frame: Frame) -> None:
        picture = CarPicture(frame.ego)
        self._draw_roads(frame, picture)
        near = [
            each for each in frame.vehicles if math.hypot(each.x - frame.ego.x, each.y - frame.ego.y) < NEAR
        ]
        self._draw_vehicles("car/vehicles", near, picture, colours.VEHICLE, colours.VEHICLE_EDGE)
        self._draw_vehicles("car/ego", [frame.ego], picture, colours.EGO, colours.EGO_EDGE)
        route = picture.points(points_of(frame.route))
        self._stream.log(
            "car/route/line", rr.LineStrips2D([route], colors=[colours.ROUTE], radii=[0.15], draw_order=10)
        )
        self._stream.log(
            "car/route/points", rr.Points2D(route, colors=[colours.ROUTE], radii=[0.4], draw_order=11)
        )
        if not frame.HasField("waypoint"):
            return
        waypoint = picture.points(points_of([frame.waypoint]))
        way = rr.LineStrips2D(
            [np.vstack([np.zeros((1, 2)), waypoint])], colors=[colours.WAYPOINT], radii=[0.1]
        )
        self._stream.log("car/waypoint/way", way)
        point = rr.Points2D(waypoint, colors=[colours.WAYPOINT], radii=[0.7], draw_order=40)
        self._stream.log("car/waypoint/point", point)

    def _draw_roads(self, frame: Frame, picture: CarPicture) -> None:
        reach = [lane for lane in self._lanes if _near(lane, frame.ego.x, frame.ego.y)]
        strips = [picture.points(lane) for lane in reach]
        road = rr.LineStrips2D(strips, colors=[colours.ROAD], radii=[ROAD_RADIUS], draw_order=0)
        self._stream.log("car/road", road)
        lanes = rr.LineStrips2D(strips, colors=[colours.LANE], radii=[LANE_RADIUS], draw_order=1)
        self._stream.log("car/lanes", lanes)

    def _draw_vehicles(
        self, entity: str, vehicles: list, picture: CarPicture, colour: tuple, edge: tuple
    ) -> None:
        bodies = [picture.points(line) for line in bodies_of(vehicles)]
        widths = [each.width / 2 for each in vehicles]
        self._stream.log(
            f"{entity}/body", rr.LineStrips2D(bodies, colors=[colour], radii=widths, draw_order=20)
        )
        outlines = [picture.points(outline) for outline in outlines_of(vehicles)]
        outlines += [picture.points(line) for line in windscreens_of(vehicles)]
        lines = rr.LineStrips2D(outlines, colors=[edge], radii=[0.09], draw_order=21)
        self._stream.log(f"{entity}/outline", lines)

    def _draw_images(self, frame: Frame) -> None:
        size = (frame.image_height, frame.image_width)
        layers = (colours.TOWN_ROAD, colours.VEHICLE_EDGE, colours.ROUTE)
        if frame.birdeye:  # a frame may have none
            birdeye = np.frombuffer(frame.birdeye, np.uint8).reshape(*size, 3)
            self._stream.log("sees/birdeye", rr.Image(painted(birdeye, layers)))
        if frame.lidar:
            lidar = np.frombuffer(frame.lidar, np.uint8).reshape(*size, 1)
            self._stream.log("sees/lidar", rr.Image(painted(lidar, (colours.EGO_EDGE,))))

    def _draw_curves(self, frame: Frame) -> None:
        curves: dict[str, tuple[float, tuple[int, int, int]]] = {
            "speed/actual": (frame.ego.speed, colours.SPEED),
            "return/return": (frame.episode_return, colours.RETURN),
            "reward/total": (frame.reward, colours.CURVE),
        }
        if not math.isnan(frame.target_speed):  # some planners decide no target speed
            curves["speed/target"] = (frame.target_speed, colours.TARGET_SPEED)
        for name, value in frame.decision.items():
            curves[f"decision/{name}"] = (value, colours.DECISION)
        for term, value in frame.reward_terms.items():
            curves[f"reward/{term}"] = (value, colours.REWARD_TERMS.get(term, colours.CURVE))
        for entity, (value, colour) in curves.items():
            name = entity.split("/")[1]
            self._stream.log(
                entity, rr.Scalars(value), rr.SeriesLines(colors=[colour], names=[name], widths=[1.5])
            )


def _near(lane: np.ndarray, x: float, y: float) -> bool:
    """Whether the rectangle around a lane comes within NEAR of a place."""
    low, high = lane.min(0) - NEAR, lane.max(0) + NEAR
    return bool(low[0] <= x <= high[0] and low[1] <= y <= high[1])


def _caption(frame: Frame) -> str:
    driver = f"policy {frame.policy_version}" if frame.driver == "policy" else frame.driver
    return (
        f"**{driver}** in {frame.town}, seed {frame.episode_seed}\n\n"
        f"decision {frame.step}, {frame.time:.1f} s, return {frame.episode_return:.0f}, "
        f"{frame.ego.speed:.1f} m/s{_in_words(frame.decision)}"
    )


def _in_words(decision: Mapping[str, float]) -> str:
    """The planner's decision, for the end of the caption; empty without a planner."""
    intention = decision.get(INTENTION)
    if intention is not None:
        words = "left" if intention < 2 / 3 else "straight" if intention < 4 / 3 else "right"
        return f", intends {words} ({intention:.2f})"
    return "".join(f", {name.replace('_', ' ')} {value:.2f}" for name, value in sorted(decision.items()))
