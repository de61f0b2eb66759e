"""The ego: highway-env's bicycle model behind the two controllers."""

from __future__ import annotations

import math

import numpy as np
from highway_env.road.road import Road
from highway_env.utils import Vector
from highway_env.vehicle.graphics import VehicleGraphics
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from ..control import WHEEL_ANGLE_PER_STEERING, WaypointController


class EgoVehicle(Vehicle):
    """A car of 4.9 x 2.1 m that drives to a waypoint at a target speed.

    The motion is that of highway-env's `Vehicle`, save that the axles lie where such a car has them and not
    at its bumpers, and that brakes stop the car and do not push it backwards.
    """

    LENGTH = 4.9
    WIDTH = 2.1
    WHEELBASE = 2.85
    """Distance between the axles, m; with 21 degrees of steering the centre turns with a radius of 7.6 m."""

    tick: float
    """Interval at which `act` is called, s."""
    impact: NDArray[np.float64] | None
    """Shift by a collision that the next step carries out, m."""
    steering: float
    """Last steering command, within +-0.3, positive to the right."""

    def __init__(
        self,
        road: Road,
        position: Vector,
        heading: float = 0,
        speed: float = 0,
        predition_type: str = "constant_steering",
    ) -> None:
        # highway-env would look for the nearest lane here and at every step; the environment knows the lane.
        super().__init__(None, position, heading, speed, predition_type)
        self.road = road
        self.color = VehicleGraphics.EGO_COLOR
        self.controller = WaypointController()
        self.tick = 0.1
        self.target_speed = 0.0
        self.waypoint = (float(self.position[0]), float(self.position[1]))
        self.steering = 0.0

    def follow(self, target_speed: float, waypoint: tuple[float, float]) -> None:
        """Take a decision: a speed (m/s) and a point (m) in the world, kept until the next decision."""
        self.target_speed = target_speed
        self.waypoint = waypoint

    def act(self, action: dict | str | None = None) -> None:
        """Run both controllers for one tick; `action` sets acceleration and wheel angle directly instead."""
        if action is not None:
            super().act(action)
            return
        x, y = float(self.position[0]), float(self.position[1])
        self.steering = self.controller.steering(x, y, self.heading, self.waypoint, self.tick)
        acceleration = self.controller.acceleration(self.speed, self.target_speed, self.tick)
        self.action = {
            "steering": self.steering * WHEEL_ANGLE_PER_STEERING,
            "acceleration": acceleration,
        }

    def step(self, dt: float) -> None:
        """Move for `dt` seconds: highway-env's equations with this car's wheelbase."""
        self.clip_actions()
        acceleration = max(self.action["acceleration"], -self.speed / dt)
        slip = math.atan(0.5 * math.tan(self.action["steering"]))
        self.position[0] += self.speed * math.cos(self.heading + slip) * dt
        self.position[1] += self.speed * math.sin(self.heading + slip) * dt
        if self.impact is not None:
            self.position += self.impact
            self.crashed = True
            self.impact = None
        self.heading += self.speed * math.sin(slip) / (self.WHEELBASE / 2) * dt
        self.speed += acceleration * dt
        self.on_state_update()

    def on_state_update(self) -> None:
        """Keep the history that highway-env's renderer may ask for; the lane is the environment's to set."""
        if self.road.record_history:
            self.history.appendleft(self.create_from(self))
