"""A recorded episode is driven again with the same states to the last bit, or it is told what differs."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import athrl_driving
import numpy as np
import pytest
from athrl_evaluator import EvaluationSettings, evaluate_driver
from athrl_evaluator.errors import EvaluatorError
from athrl_evaluator.policies.shipped import shipped_policy
from athrl_evaluator.recording.origin import Origin
from athrl_evaluator.recording.reading import InvalidRecording, read_driven, read_frames
from athrl_evaluator.recording.recordings import EpisodeRecording
from athrl_evaluator.replay import replay
from athrl_protocol import Frame
from athrl_protocol.run_file import EnvironmentSection
from numpy.typing import NDArray

TOWN02 = Path(athrl_driving.__path__[0]) / "maps" / "towns" / "town02.xodr"


def record(folder: Path, driver: str | Path, town: str, episodes: int = 2) -> list[Path]:
    """Record short episodes in a town or a case study."""
    fixed = {"episode_ticks": 80, "vehicles": 15}
    if town.startswith("town") or town.endswith(".xodr"):
        settings = EvaluationSettings(episodes, 7, EnvironmentSection(towns=town, **fixed), batch=3)
    else:
        settings = EvaluationSettings(episodes, 7, EnvironmentSection(**fixed), case_study=town, batch=3)
    evaluate_driver(driver, settings, record=folder)
    return sorted(folder.glob("*.mcap"))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recording"), "rule-based", "town02")[0]


def rewritten(
    recording: Path,
    path: Path,
    *,
    origin: Callable[[Origin], Origin] = lambda origin: origin,
    frame: Callable[[Frame], None] = lambda frame: None,
    action: Callable[[NDArray[np.float32]], None] = lambda action: None,
) -> Path:
    """A recording with the fifth decision changed, or its origin."""
    driven = read_driven(recording)
    changed = EpisodeRecording(path, origin(driven.origin))
    for place, each in enumerate(read_frames(recording)):
        if place == 4:
            frame(each)
            action(driven.actions[place])
        changed.write(each, driven.actions[place])
    changed.finish()
    return path


def elsewhere(origin: Origin) -> Origin:
    return replace(origin, kernels="0" * 16, athrl="0.1")


@pytest.mark.parametrize(
    ("driver", "town", "episodes"),
    [
        ("rule-based", "town02", 3),
        ("random", "town03", 2),
        ("rule-based", "town04", 2),
        ("policy", "roundabout", 3),
    ],
)
def test_ten_episodes_are_driven_again_with_the_same_states_bit_for_bit(
    driver: str, town: str, episodes: int, tmp_path: Path
) -> None:
    who = shipped_policy("town03") if driver == "policy" else driver
    recordings = record(tmp_path, who, town, episodes)
    assert len(recordings) == episodes
    for place, path in enumerate(recordings):
        verdict = replay(path)
        assert (verdict.same, verdict.recorded_by, verdict.first, verdict.largest) == (True, "", None, None)
        assert (verdict.driver, verdict.seed) == (driver, 7 + place)
        assert verdict.decisions == len(list(read_frames(path)))


def test_the_first_difference_and_the_largest_are_told(recording: Path, tmp_path: Path) -> None:
    def steer(action: NDArray[np.float32]) -> None:
        action[1] += 0.5

    verdict = replay(rewritten(recording, tmp_path / "a.mcap", action=steer))
    assert not verdict.same
    assert verdict.first is not None
    assert verdict.largest is not None
    assert verdict.first.decision == 5
    assert verdict.largest.size > 0.01
    assert verdict.largest.decision >= 5


def test_the_last_bit_counts_here_and_not_where_it_may_differ(recording: Path, tmp_path: Path) -> None:
    def shift(frame: Frame) -> None:
        frame.vehicles[3].x = np.nextafter(frame.vehicles[3].x, np.inf)
        frame.lidar = bytes(len(frame.lidar))

    here = replay(rewritten(recording, tmp_path / "here.mcap", frame=shift))
    assert here.first is not None
    assert here.first == here.largest
    assert (here.first.decision, here.first.number) == (5, "vehicles[3].x")
    there = replay(rewritten(recording, tmp_path / "there.mcap", frame=shift, origin=elsewhere))
    assert there.same
    assert "athrl-driving 0.1" in there.recorded_by
    assert there.largest is not None
    assert 0.0 < there.largest.size < 1e-9

    def move(frame: Frame) -> None:
        frame.vehicles[3].x += 1e-3

    moved = replay(rewritten(recording, tmp_path / "moved.mcap", frame=move, origin=elsewhere))
    assert moved.first is not None
    assert moved.first.size == pytest.approx(1e-3)


def test_another_image_a_missing_vehicle_and_a_longer_episode_are_differences(
    recording: Path, tmp_path: Path
) -> None:
    def paint(frame: Frame) -> None:
        frame.birdeye = bytes([1]) + frame.birdeye[1:]

    def remove(frame: Frame) -> None:
        del frame.vehicles[-1]

    painted = replay(rewritten(recording, tmp_path / "painted.mcap", frame=paint)).first
    assert painted is not None
    assert painted.number == "birdeye[0]"
    removed = replay(rewritten(recording, tmp_path / "removed.mcap", frame=remove, origin=elsewhere)).first
    assert removed is not None
    assert removed.number.startswith("vehicles[14].")
    ends = replay(
        rewritten(
            recording,
            tmp_path / "ends.mcap",
            origin=lambda origin: replace(origin, settings={**origin.settings, "episode_ticks": 40}),
        )
    ).first
    assert ends is not None
    assert ends.decision == 11


def test_a_recording_that_was_cut_off_is_driven_as_far_as_it_goes(recording: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[:-200])
    assert replay(cut).same


def test_a_map_is_found_where_it_is_now_and_another_one_is_refused(tmp_path: Path) -> None:
    here, there = tmp_path / "here.xodr", tmp_path / "there.xodr"
    shutil.copy(TOWN02, here)
    path = record(tmp_path / "recordings", "blind", str(here))[0]
    here.rename(there)
    with pytest.raises(EvaluatorError, match=r"here.xodr: there is no such file; say .* by --town$"):
        replay(path)
    assert replay(path, str(there)).same
    there.write_text(there.read_text().replace("<header", "<header  ", 1))
    with pytest.raises(EvaluatorError, match=r"there.xodr is another map than the recorded .* should be"):
        replay(path, str(there))


def test_a_recording_that_does_not_say_how_it_was_driven_says_what_it_lacks(
    recording: Path, tmp_path: Path
) -> None:
    old = EpisodeRecording(tmp_path / "old.mcap")
    for frame in read_frames(recording):
        old.write(frame)
    old.finish()
    with pytest.raises(InvalidRecording, match=r"it has no settings, no map's checksum and no actions, as"):
        replay(tmp_path / "old.mcap")
    half = EpisodeRecording(tmp_path / "half.mcap", read_driven(recording).origin)
    for frame in read_frames(recording):
        half.write(frame)
    half.finish()
    with pytest.raises(InvalidRecording, match=r"it has 0 actions for 20 decisions, it should have a finite"):
        replay(tmp_path / "half.mcap")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"settings": {"town": 3}}, "its settings name no town"),
        ({"settings": {"town": "town02", "action": {"type": "X"}}}, "its type should be WaypointAction or"),
        ({"settings": {"town": "town02", "action": 3}}, "the setting action is 3, its type should be"),
        ({"settings": {"town": "town02", "x": "y" * 70_000}}, "its settings have over 65,536 characters"),
        ({"seed": "one"}, "its origin .*'one'"),
        ({"seed": -1}, "its seed is -1, it should be from 0 to 2\\^64 - 1"),
        ({"seed": 2**64}, "its seed is 18446744073709551616, it should be from 0"),
        ({"athrl": "\x1b[31mred"}, "its athrl should be a printable text of at most 200 characters"),
        ({"processor": "x" * 201}, "its processor should be a printable text"),
    ],
)
def test_an_origin_that_cannot_be_is_refused_in_one_line(
    recording: Path, tmp_path: Path, change: dict, message: str
) -> None:
    path = rewritten(recording, tmp_path / "a.mcap", origin=lambda origin: replace(origin, **change))
    with pytest.raises((EvaluatorError, InvalidRecording), match=message) as error:
        replay(path)
    assert "\n" not in str(error.value)


def test_settings_of_another_release_are_refused_in_one_line(recording: Path, tmp_path: Path) -> None:
    def with_unknown(origin: Origin) -> Origin:
        return replace(origin, settings={**origin.settings, "colour": "red"})

    path = rewritten(recording, tmp_path / "a.mcap", origin=with_unknown)
    with pytest.raises(EvaluatorError, match=r"cannot be driven again: .*no setting 'colour'"):
        replay(path)
