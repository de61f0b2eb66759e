"""`render`: highway-env's viewer with the town's junctions, levels, route and waypoints."""

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import gymnasium
import numpy as np
import pytest
from athrl_driving import TownEnv, TownVectorEnv, make_driver

BUILT = (
    "from athrl_driving import TownEnv, TownVectorEnv; TownEnv().step(None); TownVectorEnv(2).reset(seed=1)"
)


def driven(environment: str = "athrl/Town03-v0", decisions: int = 5, **config: object) -> TownEnv:
    """An environment that can be rendered, after some decisions."""
    env = gymnasium.make(environment, render_mode="rgb_array", config=config).unwrapped
    env.reset(seed=3)
    driver = make_driver("rule-based")
    driver.reset(env, 3)
    for _ in range(decisions):
        env.step(driver.act(env))
    return env


def colour_at(env: TownEnv, frame: np.ndarray, x: float, y: float) -> tuple[int, ...]:
    """The colour of a place in the town, which has to lie within the picture."""
    centre, scaling = np.array(env.vehicle.position), env.config["scaling"]
    column, line = ((np.array([x, y]) - centre) * scaling + 300).astype(int)
    return tuple(frame[line, column].tolist())


def dense(line: np.ndarray) -> np.ndarray:
    """A line float64 [n, 2] with about a point a metre."""
    along = np.append(0.0, np.hypot(*np.diff(line, axis=0).T).cumsum())
    places = np.linspace(0.0, along[-1], int(along[-1]) + 3)
    return np.stack([np.interp(places, along, line[:, axis]) for axis in (0, 1)], axis=1)


def test_ways_through_junctions_are_drawn_as_road_and_what_is_no_road_is_not() -> None:
    env = driven(decisions=0, vehicles_count=0)
    lines = [dense(line) for line in env.town.lane_polylines()]
    ways = np.flatnonzero(env.town.graph.movement >= 0).tolist()
    env.vehicle.position = lines[ways[0]][0] + np.array([30.0, 30.0])  # beside a junction
    frame = env.render()
    ego = env.vehicle.position
    points = np.concatenate([lines[lane] for lane in ways])
    roads = {colour_at(env, frame, *place) for place in points[np.abs(points - ego).max(axis=1) < 49]}
    grid = ego + np.stack(np.meshgrid(*[np.arange(-45.0, 46.0, 5.0)] * 2), axis=-1).reshape(-1, 2)
    distance = np.hypot(*(grid[:, None] - np.concatenate(lines)[None]).transpose(2, 0, 1)).min(axis=1)
    beside = {colour_at(env, frame, *place) for place in grid[distance > 8] if np.abs(place - ego).max() > 15}
    assert roads
    assert len(beside) == 1
    assert not roads & beside
    env.close()


def test_the_route_and_its_waypoints_and_the_planners_waypoint_are_drawn() -> None:
    from athrl_driving.envs.viewer import ROUTE, WAYPOINT

    env = driven(vehicles_count=0)
    frame = env.render()
    near = [
        point for point in env.route.waypoints()[:, :2] if np.abs(point - env.vehicle.position).max() < 49
    ]
    assert len(near) >= 5
    planners = np.array(env.vehicle.waypoint)
    for point in near:
        if np.hypot(*(point - planners)) > 2:
            assert colour_at(env, frame, *point) in (ROUTE, WAYPOINT)
    assert colour_at(env, frame, *planners) == WAYPOINT
    env.close()


def test_a_vehicle_below_an_overpass_is_hidden_and_one_on_it_is_not() -> None:
    env = driven("athrl/Town04-v0", decisions=0, vehicles_count=1)
    graph, background = env.town.graph, env.road.background
    middle = graph.elevation + 0.5 * graph.grade * graph.length
    bridge = int(middle.argmax())
    line = dense(env.town.lane_polylines()[bridge])
    place = line[len(line) // 2]
    env.vehicle.position = place + np.array([20.0, 20.0])
    background.x[0], background.y[0], background.lane[0] = *place, bridge
    colours = []
    for elevation in (float(middle[bridge]), 0.0):
        background.elevation[0] = elevation
        colours.append(colour_at(env, env.render(), *place))
    assert colours[0] != colours[1]
    env.close()


@pytest.mark.parametrize("scaling", [2.0, 12.0])
def test_pictures_of_any_scale_have_the_size_that_the_settings_say(scaling: float) -> None:
    env = driven(scaling=scaling, screen_width=320, screen_height=200)
    frame = env.render()
    assert (frame.shape, frame.dtype) == ((200, 320, 3), np.uint8)
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 4
    env.close()


def test_trajectories_show_past_positions_of_this_episode_only() -> None:
    from athrl_driving.envs.viewer import TRAIL

    def dots(frame: np.ndarray) -> int:
        return int((frame == TRAIL).all(axis=-1).sum())

    env = driven(show_trajectories=True)
    assert dots(env.render()) == 0
    env.step(np.array([1.0, 0.0], np.float32))
    assert dots(env.render()) > 0
    env.reset(seed=4)
    assert dots(env.render()) == 0
    env.close()


def test_a_vector_renders_what_gymnasiums_own_vector_of_single_environments_does() -> None:
    arguments = {"num_envs": 3, "render_mode": "rgb_array", "config": {"vehicles_count": 30}}
    frames = []
    for mode in ("vector_entry_point", "sync"):
        envs = gymnasium.make_vec("athrl/Town03-v0", vectorization_mode=mode, **arguments)
        envs.reset(seed=7)
        for _ in range(3):
            envs.step(np.tile(np.array([[0.5, 0.0]], np.float32), (3, 1)))
        frames.append(envs.render())
        envs.close()
    assert type(frames[0]) is type(frames[1]) is tuple
    np.testing.assert_array_equal(frames[0], frames[1])
    assert (frames[0][0] != frames[0][1]).any()


@pytest.mark.parametrize("config", [{}, {"simulation_frequency": 20}, {"ticks_per_decision": 2}])
def test_a_picture_a_decision_is_real_time_alone_and_in_vectors(config: dict) -> None:
    alone = gymnasium.make("athrl/Town02-v0", config={**config, "vehicles_count": 0})
    vectors = [
        gymnasium.make_vec("athrl/Town02-v0", 2, mode, config={**config, "vehicles_count": 0})
        for mode in ("sync", "vector_entry_point")
    ]
    other = TownEnv({"simulation_frequency": 5, "vehicles_count": 0})  # has no effect on those before
    assert other.metadata["render_fps"] == 1.25
    decisions_a_second = config.get("simulation_frequency", 10) / config.get("ticks_per_decision", 4)
    assert {env.metadata["render_fps"] for env in (alone, *vectors)} == {decisions_a_second}


@pytest.fixture
def videos(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, float]]:
    """Pictures and pictures a second of each video that gymnasium's wrapper hands over to moviepy."""
    written: list[tuple[int, float]] = []

    class Clip:
        def __init__(self, frames: list[np.ndarray], fps: float) -> None:
            written.append((len(frames), fps))

        def write_videofile(self, *_: object, **__: object) -> None:
            pass

    module = ModuleType("moviepy.video.io.ImageSequenceClip")
    module.ImageSequenceClip = Clip
    for name in ("moviepy", "moviepy.video", "moviepy.video.io"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return written


@pytest.mark.parametrize("every_tick", [False, True])
def test_videos_of_some_episodes_last_as_long_as_these(
    every_tick: bool, tmp_path: Path, videos: list[tuple[int, float]]
) -> None:
    env = gymnasium.make("athrl/Town02-v0", render_mode="rgb_array", config={"vehicles_count": 0})
    env = gymnasium.wrappers.RecordVideo(
        env, str(tmp_path / "videos"), episode_trigger=lambda episode: episode != 1
    )
    if every_tick:
        env.unwrapped.set_record_video_wrapper(env)
    for episode in range(4):
        env.reset(seed=episode)
        for _ in range(3):
            env.step(np.array([1.0, 0.0], np.float32))
    env.close()
    assert len(videos) == 3
    for pictures, pictures_a_second in videos:
        assert (pictures - 1) / pictures_a_second == pytest.approx(3 * 0.4)
    assert (videos[0][1] == 10.0) == every_tick


def test_an_unknown_way_to_render_is_refused_in_one_line() -> None:
    with pytest.raises(ValueError, match=r"^render_mode is 'ansi', it should be None, 'human' or.*$"):
        TownEnv(render_mode="ansi")


def test_a_vector_has_no_window_of_its_own() -> None:
    with pytest.raises(ValueError, match=r"^render_mode is 'human', it should be None or 'rgb_array'.*$"):
        TownVectorEnv(2, render_mode="human")
    assert TownVectorEnv(2).render() is None


def test_without_rendering_no_drawing_code_is_loaded() -> None:
    probe = f"import sys; {BUILT}; print('athrl_driving.envs.viewer' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, timeout=300)
    assert result.stdout.strip() == "False", result.stderr
