"""Loads a map and drives on it for 20 seconds, checking that what happens could happen on a road."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from athrl_driving import make_driver
from athrl_driving.envs import TownEnv
from athrl_driving.errors import DrivingError
from athrl_driving.maps import Town
from numpy.typing import NDArray
from scipy.spatial import KDTree

TICKS = 200
"""At 10 a second."""

FASTEST = 30.0
"""m/s; nobody wants to drive even half as fast."""

_FARTHEST_OUT = 300.0
"""Metres from the map that an ego may get, which may drive off the road."""

_BESIDE = 1.5
"""Metres beyond a lane's edge at which the centre of a background vehicle is off the road."""

_SPACING = 1.0
"""Metres between points of a lane's centre line."""

_ROOM = re.compile(r"room for (\d+) at most")


class NonsenseError(Exception):
    """What was promised of driving on any map does not hold."""


def drive_on(path: Path, vehicles: int, seed: int) -> None:
    """Drive with `vehicles` others, or as many as there is room for, and the rule-based driver as the ego.

    Raises DrivingError where the map is refused, and NonsenseError or any other error where it is not and yet
    no map to drive on.
    """
    env = _environment(path, vehicles, seed)
    try:
        _drive(env, seed)
    except DrivingError as error:
        if _ROOM.search(str(error)):
            return  # where the ego starts now, it leaves room for fewer
        raise NonsenseError(f"refused only after the first episode had begun: {error}") from error
    finally:
        env.close()


def _drive(env: TownEnv, seed: int) -> None:
    """Drive `TICKS` ticks, in as many episodes as it takes."""
    roads, driver, left = Roads(env.town), make_driver("rule-based"), TICKS
    while left > 0:
        driver.reset(env, seed)
        for _ in _decisions(env, driver):
            roads.check(env)
            left -= env.config["ticks_per_decision"]
        seed += 1
        env.reset(seed=seed)


def _environment(path: Path, vehicles: int, seed: int) -> TownEnv:
    """Return an environment in its first episode, with fewer vehicles where so many have no room."""
    try:
        env = TownEnv({"vehicles_count": vehicles, "episode_ticks": TICKS}, map=str(path))
        env.reset(seed=seed)
    except DrivingError as error:
        room = _ROOM.search(str(error))
        if room is None or int(room[1]) >= vehicles:
            raise
        return _environment(path, int(room[1]), seed)
    return env


def _decisions(env: TownEnv, driver: object) -> Iterator[None]:
    """Drive an episode; between its decisions the caller looks at it."""
    ended, before = False, 0.0
    while not ended:
        observation, reward, terminated, truncated, info = env.step(driver.act(env))  # type: ignore[attr-defined]
        ended = terminated or truncated
        numbers = {"reward": reward, "speed": info["speed"], "distance": info["distance"]}
        numbers |= info.get("metrics", {})
        for name, value in numbers.items():
            if math.isnan(value):
                raise NonsenseError(f"the ego's {name} is {value}")
        if not all(np.isfinite(each).all() for each in observation.values()):
            raise NonsenseError("an observation is not finite")
        driven = info["distance"] - before
        most = FASTEST * 0.1 * info["ticks"]
        if not -most <= driven <= most:
            raise NonsenseError(f"the ego drove {driven:g} m in {info['ticks']} ticks")
        before = info["distance"]
        yield


class Roads:
    """Where the lanes are."""

    def __init__(self, town: Town) -> None:
        lines = [_dense(line) for line in town.lane_polylines(_SPACING)]
        self._points = np.concatenate(lines)
        self._reach = 0.5 * np.repeat(town.graph.width, [len(line) for line in lines]) + _SPACING + _BESIDE
        self._tree = KDTree(self._points)

    def check(self, env: TownEnv) -> None:
        """Raise an error unless all vehicles are where vehicles can be, and as fast."""
        background = env.road.background
        state = np.stack([background.x, background.y, background.heading, background.elevation])
        if not np.isfinite(state).all():
            raise NonsenseError("a vehicle is nowhere: its place is not finite")
        _check_speeds("a vehicle", background.speed)
        self._check_on_road(state[:2].T)
        ego = env.vehicle
        _check_speeds("the ego", np.array([ego.speed]))
        if not np.isfinite(ego.position).all() or self._tree.query(ego.position)[0] > _FARTHEST_OUT:
            raise NonsenseError(f"the ego is at {ego.position.tolist()}, away from every road")

    def _check_on_road(self, places: NDArray[np.float64]) -> None:
        """Check the places [N, 2] of the background vehicles."""
        # Beside a wide lane the nearest one may be narrow: all that could be wide enough are looked at.
        near = self._tree.query_ball_point(places, self._reach.max())
        for place, points in zip(places, near, strict=True):
            apart = np.hypot(*(self._points[points] - place).T)
            if not (apart <= self._reach[points]).any():
                nearest = self._tree.query(place)[0]
                raise NonsenseError(f"a vehicle is {nearest:.1f} m from the centre of every lane")


def _dense(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a line [n, 2] with a point at least every `_SPACING` metres."""
    along = np.concatenate([[0.0], np.hypot(*np.diff(line, axis=0).T).cumsum()])
    at = np.linspace(0.0, along[-1], math.ceil(along[-1] / _SPACING) + 1)
    return np.stack([np.interp(at, along, line[:, axis]) for axis in (0, 1)], axis=1)


def _check_speeds(who: str, speeds: NDArray[np.float64]) -> None:
    if not (np.abs(speeds) <= FASTEST).all():  # NaN is not either
        raise NonsenseError(f"{who} has a speed of {speeds[np.argmax(~(np.abs(speeds) <= FASTEST))]:g} m/s")
