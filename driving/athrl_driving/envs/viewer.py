"""What `render` shows: the town with its junctions, the traffic, the ego, its route and its waypoints.

highway-env's viewer provides the window, its keys and the vehicles; the ground and the route are drawn here.
Only `render` imports this module.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import pygame
from highway_env.envs.common.graphics import EnvViewer
from highway_env.road.graphics import RoadGraphics, WorldSurface
from highway_env.vehicle.graphics import VehicleGraphics
from numpy.typing import NDArray

from athrl_driving.envs.ego_vehicle import EgoVehicle
from athrl_driving.envs.ground import MEADOW, Ground, level_of
from athrl_driving.envs.road import EpisodeRoad
from athrl_driving.maps import Town
from athrl_driving.route import WAYPOINT_SPACING, WAYPOINTS_KNOWN, Route
from athrl_driving.scene import Scene

ROUTE = (90, 230, 170)
WAYPOINT = (240, 110, 20)
TRAIL = (235, 235, 235)
TRAIL_SECONDS = 2.0
"""For how long past positions are shown with the setting `show_trajectories`, s."""

_POINTS_BETWEEN = 5  # of the route's line, between two waypoints
_LINE_WIDTH, _DOT, _WAYPOINT_DOT, _TRAIL_DOT = 0.4, 0.6, 0.9, 0.25  # m


class Rendered(Protocol):
    """What is drawn: a `TownEnv`, or one environment of a batch."""

    config: Mapping[str, Any]

    @property
    def road(self) -> EpisodeRoad:
        """The road with its vehicles."""

    @property
    def vehicle(self) -> EgoVehicle:
        """The ego."""

    @property
    def route(self) -> Route:
        """The ego's route."""

    def scene(self) -> Scene:
        """The present moment."""


class TownPicture:
    """Draws scenes of a town onto a surface of highway-env."""

    def __init__(self, town: Town) -> None:
        self._ground = Ground(town)
        self._trails: dict[int, list[Scene]] = {}

    def draw(self, env: Rendered, surface: WorldSurface, offscreen: bool) -> None:
        """Draw the visible part of the present scene, from the lowest level up."""
        road, ego = env.road, env.vehicle
        surface.fill(MEADOW)
        lanes = self._ground.visible(surface)
        lane_levels = self._ground.levels[lanes]
        vehicles = [ego, *road.vehicles[1:]]
        vehicle_levels = level_of(np.append(ego.elevation, road.background.elevation))
        for level in sorted({*lane_levels.tolist(), *vehicle_levels.tolist()}):
            self._ground.draw(surface, lanes[lane_levels == level])
            if level == vehicle_levels[0]:
                if env.config["show_trajectories"]:
                    self._draw_trails(env.scene(), road.environment, surface)
                _draw_route(env.route, surface)
                RoadGraphics.display_road_objects(road, surface, offscreen=offscreen)
            for place in np.flatnonzero(vehicle_levels == level).tolist():
                VehicleGraphics.display(vehicles[place], surface, offscreen=offscreen)
        _draw_waypoint(ego, surface)

    def _draw_trails(self, scene: Scene, environment: int, surface: WorldSurface) -> None:
        """Draw where all vehicles were at the moments that were drawn before."""
        earlier = [
            moment
            for moment in self._trails.get(environment, [])
            if 0.0 < scene.time - moment.time <= TRAIL_SECONDS
        ]
        self._trails[environment] = [*earlier, scene]
        for moment in earlier:
            for vehicle in (moment.ego, *moment.vehicles):
                place = surface.pos2pix(vehicle.x, vehicle.y)
                pygame.draw.circle(surface, TRAIL, place, max(surface.pix(_TRAIL_DOT), 1))


class TownViewer(EnvViewer):
    """highway-env's viewer of an environment, which shows pictures of towns."""

    def __init__(self, env: Rendered, offscreen: bool) -> None:
        super().__init__(env, {**env.config, "offscreen_rendering": offscreen})
        pygame.display.set_caption("athrl")
        if offscreen:
            self.enabled = True  # without a screen highway-env draws nothing, but none is needed here
        self._picture = TownPicture(env.road.town)

    def display(self) -> None:
        """Draw the present moment, and show it if there is a window."""
        if not self.enabled:
            return
        self.sim_surface.move_display_window_to(self.window_position())
        self._picture.draw(self.env, self.sim_surface, self.offscreen)
        if self.offscreen:
            return
        self.screen.blit(self.sim_surface, (0, 0))
        if self.config["real_time_rendering"]:
            self.clock.tick(self.config["simulation_frequency"])
        pygame.display.flip()


class BatchViewer:
    """Pictures of the environments of a batch, one after the other on one surface."""

    def __init__(self, environments: Sequence[Rendered]) -> None:
        self._environments = environments
        self._viewer = TownViewer(environments[0], offscreen=True)

    def images(self) -> tuple[NDArray[np.uint8], ...]:
        """The present moment of each environment, uint8 [height, width, 3]."""
        return tuple(self._image(each) for each in self._environments)

    def _image(self, environment: Rendered) -> NDArray[np.uint8]:
        self._viewer.env = environment
        self._viewer.display()
        return self._viewer.get_image()


def _draw_route(route: Route, surface: WorldSurface) -> None:
    """Draw the route from the ego to the last known waypoint, and these waypoints."""
    waypoints = route.waypoints()[:, :2]
    end = WAYPOINT_SPACING * (np.floor(route.position / WAYPOINT_SPACING) + WAYPOINTS_KNOWN)
    ahead = np.linspace(route.position, end, 1 + WAYPOINTS_KNOWN * _POINTS_BETWEEN)
    points = [surface.vec2pix(point) for point in route.poses(ahead)[:, :2]]
    pygame.draw.lines(surface, ROUTE, False, points, max(surface.pix(_LINE_WIDTH), 1))
    for point in waypoints:
        pygame.draw.circle(surface, ROUTE, surface.vec2pix(point), max(surface.pix(_DOT), 2))


def _draw_waypoint(ego: EgoVehicle, surface: WorldSurface) -> None:
    """Draw the waypoint of the last decision, if there is one, and a line to it."""
    if ego.waypoint is None:
        return
    place, waypoint = surface.vec2pix(ego.position), surface.vec2pix(ego.waypoint)
    if place == waypoint:  # before the first decision
        return
    pygame.draw.line(surface, WAYPOINT, place, waypoint, max(surface.pix(_LINE_WIDTH), 1))
    pygame.draw.circle(surface, WAYPOINT, waypoint, max(surface.pix(_WAYPOINT_DOT), 3))
