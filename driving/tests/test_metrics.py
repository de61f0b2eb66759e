"""The metrics of trajectories with known metrics."""

import math

import numpy as np
import pytest
from athrl_driving.kernels.compilation import compiled
from athrl_driving.metrics import (
    COMFORT_BOUNDS,
    MetricsState,
    TickRecord,
    environment_metrics,
    new_metrics,
    note_tick,
    reset_metrics,
    summary,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

DT = 0.1


@compiled
def _reset(metrics: MetricsState, environment: int, speed: float, heading: float, goal: float) -> None:
    reset_metrics(environment_metrics(metrics, environment), speed, heading, goal)


@compiled
def _note(
    metrics: MetricsState,
    environment: int,
    speed: float,
    heading: float,
    time_to_collision: float,
    red_light: bool,
    collision: int,
    left_lane: bool,
    arrived: bool,
) -> None:
    tick = TickRecord(
        speed, heading, speed * 0.1, -0.5, time_to_collision, red_light, collision, left_lane, arrived, 0.1
    )
    note_tick(environment_metrics(metrics, environment), tick)


class Drive:
    """An episode of one environment among three, driven by hand."""

    def __init__(self, speed: float = 0.0, heading: float = 0.0, goal: float = 400.0) -> None:
        self.metrics = new_metrics(3)
        _reset(self.metrics, 1, speed, heading, goal)

    def tick(
        self,
        speed: float,
        heading: float = 0.0,
        time_to_collision: float = math.inf,
        red_light: bool = False,
        collision: int = 0,
        left_lane: bool = False,
        arrived: bool = False,
    ) -> None:
        _note(self.metrics, 1, speed, heading, time_to_collision, red_light, collision, left_lane, arrived)

    def summary(self, lasted: bool = True) -> dict[str, float]:
        return summary(self.metrics, 1, lasted=lasted)


def driven(speeds: NDArray, headings: NDArray) -> dict[str, float]:
    drive = Drive(float(speeds[0]), float(headings[0]))
    for speed, heading in zip(speeds[1:], headings[1:], strict=True):
        drive.tick(float(speed), float(heading))
    return drive.summary()


def test_steady_drive_to_the_end_scores_by_its_way() -> None:
    drive = Drive(speed=6.0)
    for _ in range(500):
        drive.tick(6.0)
    result = drive.summary()
    assert result["driving_score"] == result["route_completion"] == pytest.approx(300 / 400)
    assert (result["success"], result["crash"], result["out_of_road"]) == (1.0, 0.0, 0.0)
    assert result["mean_speed"] == pytest.approx(6.0)
    assert result["distance"] == pytest.approx(300.0)
    assert result["duration"] == pytest.approx(50.0)
    assert result["mean_lateral_offset"] == pytest.approx(0.5)
    assert result["comfort_all"] == 1.0
    assert result["minimum_time_to_collision"] == 5.0


def test_infractions_cost_what_the_leaderboard_takes() -> None:
    drive = Drive(speed=8.0, goal=80.0)
    for tick in range(50):
        drive.tick(8.0, red_light=tick in (3, 20), collision=1 if tick == 49 else 0)
    result = drive.summary(lasted=False)
    assert result["infraction_penalty"] == pytest.approx(0.60 * 0.70 * 0.70)
    assert result["driving_score"] == pytest.approx(0.5 * 0.60 * 0.70 * 0.70)
    assert (result["red_lights"], result["crash"], result["success"]) == (2.0, 1.0, 0.0)
    drive = Drive(speed=8.0, goal=4.0)
    for _ in range(5):
        drive.tick(8.0)
    drive.tick(8.0, collision=2)
    assert drive.summary()["driving_score"] == pytest.approx(0.65)


def test_ends_are_distinguished() -> None:
    left = Drive(speed=5.0)
    left.tick(5.0, left_lane=True)
    assert left.summary(lasted=False)["out_of_road"] == 1.0
    assert left.summary(lasted=False)["success"] == 0.0
    arrived = Drive(speed=5.0)
    arrived.tick(5.0, arrived=True)
    assert arrived.summary(lasted=False)["success"] == 1.0
    assert arrived.summary(lasted=False)["driving_score"] == 1.0
    unfinished = Drive(speed=5.0)
    unfinished.tick(5.0)
    assert unfinished.summary(lasted=False)["success"] == 0.0


@pytest.mark.parametrize(("speed", "success"), [(0.0, 0.0), (0.49, 0.0), (0.51, 1.0)])
def test_an_ego_that_stood_has_had_no_success(speed: float, success: float) -> None:
    drive = Drive(speed=speed)
    for _ in range(500):
        drive.tick(speed)
    assert drive.summary(lasted=True)["success"] == success
    drive.tick(speed, arrived=True)
    assert drive.summary(lasted=False)["success"] == 1.0


def test_time_to_collision_is_the_least_and_its_share() -> None:
    drive = Drive(speed=5.0)
    for time in (math.inf, 2.0, 0.9, 0.95):
        drive.tick(5.0, time_to_collision=time)
    assert drive.summary()["minimum_time_to_collision"] == 0.9
    assert drive.summary()["time_to_collision_kept"] == 0.5


def test_steady_acceleration_and_turning_are_judged_by_their_values() -> None:
    """Values slightly below and above each bound, in motions that only have that quantity."""
    ticks = np.arange(101)
    time = ticks * DT
    straight = np.zeros(101)

    def share(name: str, speeds: NDArray, headings: NDArray) -> float:
        return driven(speeds, headings)[f"comfort_{name}"]

    for acceleration, kept in ((2.3, 1.0), (2.5, 0.0)):
        assert share("longitudinal_acceleration", acceleration * time, straight) == kept
    for braking, kept in ((4.0, 1.0), (4.1, 0.0)):
        assert share("longitudinal_acceleration", 50.0 - braking * time, straight) == kept
    for turning, kept in ((0.94, 1.0), (0.96, 0.0)):
        assert share("yaw_rate", straight + 1.0, -turning * time) == kept
        assert share("yaw_rate", straight + 1.0, turning * time) == kept
    for aside, kept in ((4.8, 1.0), (5.0, 0.0)):
        assert share("lateral_acceleration", straight + 10.0, aside / 10.0 * time) == kept
    for bend, kept in ((1.9, 1.0), (1.96, 0.0)):
        assert share("yaw_acceleration", straight + 1.0, 0.5 * bend * time**2) == kept
    for jerk, kept in ((4.1, 1.0), (4.2, 0.0)):
        assert share("longitudinal_jerk", 0.5 * jerk * time**2, straight) == kept
    for jerk, kept in ((8.3, 1.0), (8.5, 0.0)):
        assert share("jerk", 100.0 + 0.5 * jerk * time**2, straight) == kept


def by_fitted_parabolas(speeds: NDArray, headings: NDArray) -> NDArray[np.float64]:
    """Shares of ticks within each bound, with numpy's polynomial fits over whole trajectories."""
    turns = np.diff(headings) / DT
    along = np.diff(speeds) / DT
    aside = 0.5 * (speeds[1:] + speeds[:-1]) * turns
    headings = headings[1:]

    def fitted(values: NDArray, width: int, order: int) -> NDArray:
        width = min(width, values.size)
        result = np.empty(values.size)
        for tick in range(values.size):
            start = min(max(tick - width // 2, 0), values.size - width)
            places = (np.arange(width) + start - tick) * DT
            degree = min(2, width - 1)
            fit = np.polynomial.Polynomial(
                np.polynomial.polynomial.polyfit(places, values[start : start + width], degree)
            )
            result[tick] = fit.deriv(order)(0.0) if order else fit(0.0)
        return result

    size = np.hypot(along, aside)
    smooth = fitted(along, 7, 0)
    kept = np.array(
        [
            (smooth >= -4.05) & (smooth <= 2.40),
            np.abs(fitted(aside, 7, 0)) <= 4.89,
            np.abs(fitted(headings, 15, 1)) <= 0.95,
            np.abs(fitted(headings, 15, 2)) <= 1.93,
            np.abs(fitted(along, 15, 1)) <= 4.13,
            np.abs(fitted(size, 15, 1)) <= 8.37,
        ]
    )
    return np.append(kept.mean(axis=1), kept.all(axis=0).mean())


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 90))
def test_comfort_of_any_drive_is_that_of_parabolas_fitted_to_it(seed: int, ticks: int) -> None:
    rng = np.random.default_rng(seed)
    speeds = 8.0 + np.cumsum(rng.normal(scale=0.4, size=ticks + 1))
    headings = np.cumsum(np.cumsum(rng.normal(scale=0.02, size=ticks + 1)))
    result = driven(speeds, headings)
    shares = [result[f"comfort_{name}"] for name in (*COMFORT_BOUNDS, "all")]
    np.testing.assert_allclose(shares, by_fitted_parabolas(speeds, headings))


def test_counts_of_an_episode_do_not_reach_into_the_next_or_the_neighbours() -> None:
    drive = Drive(speed=3.0)
    for _ in range(30):
        drive.tick(9.0, heading=1.0, time_to_collision=0.1, red_light=True, collision=1, left_lane=True)
    for neighbour in (0, 2):
        assert drive.metrics.ticks[neighbour] == 0
        assert drive.metrics.infractions[neighbour].sum() == 0
    _reset(drive.metrics, 1, 5.0, 0.0, 400.0)
    for _ in range(30):
        drive.tick(5.0)
    again = Drive(speed=5.0)
    for _ in range(30):
        again.tick(5.0)
    assert drive.summary() == again.summary()


def test_summary_can_be_asked_for_twice() -> None:
    drive = Drive(speed=5.0)
    for _ in range(20):
        drive.tick(5.0)
    assert drive.summary() == drive.summary()
