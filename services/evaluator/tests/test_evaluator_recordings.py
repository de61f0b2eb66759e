"""Recordings are self-describing, complete or marked as unfinished, pruned, and can be drawn by rerun."""

import errno
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import rerun_cli
from athrl_evaluator.dashboard import links_value
from athrl_evaluator.drawing import APPLICATION, SceneDrawing, make_blueprint
from athrl_evaluator.errors import EvaluatorError
from athrl_evaluator.recording.origin import Origin
from athrl_evaluator.recording.reading import InvalidRecording, read_frames
from athrl_evaluator.recording.recorder import Recorder
from athrl_evaluator.recording.recordings import EpisodeRecording, prune_recordings
from athrl_evaluator.scoring.drivers import ReferenceDriver
from athrl_evaluator.scoring.environments import make_batch
from athrl_evaluator.scoring.episodes import drive_episodes
from athrl_protocol import Frame
from athrl_protocol.run_file import EnvironmentSection
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.writer import Writer

ENVIRONMENT = EnvironmentSection(vehicles=5, episode_ticks=40)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list]:
    folder = tmp_path_factory.mktemp("recordings")
    driver = ReferenceDriver("rule-based", 2)
    recorder = Recorder(driver, folder, episodes=2, kept=10)
    results = drive_episodes(driver, make_batch(ENVIRONMENT, 2), [1, 2, 3], [recorder])
    return folder, results


def test_each_recorded_episode_is_one_file(recorded: tuple[Path, list]):
    folder, _ = recorded
    assert sorted(os.listdir(folder)) == ["rule-based-seed-1.mcap", "rule-based-seed-2.mcap"]


def test_any_mcap_reader_can_read_it_without_our_schema(recorded: tuple[Path, list]):
    folder, results = recorded
    with (folder / "rule-based-seed-1.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        messages = list(reader.iter_decoded_messages())
    by_topic: dict[str, list] = {}
    for schema, channel, _, message in messages:
        by_topic.setdefault(channel.topic, []).append((schema.name, message))
    assert set(by_topic) == {
        *("/frame", "/action", "/birdeye", "/lidar", "/ego", "/vehicles", "/route", "/waypoint")
    }
    assert {name for name, _ in by_topic["/birdeye"]} == {"foxglove.RawImage"}
    assert {name for name, _ in by_topic["/vehicles"]} == {"foxglove.PosesInFrame"}
    frames = [message for _, message in by_topic["/frame"]]
    assert len(frames) == results[0].ticks / 4
    assert frames[-1].episode_return == pytest.approx(results[0].episode_return)
    assert len(by_topic["/birdeye"][0][1].data) == 32 * 32 * 3
    assert len(by_topic["/vehicles"][0][1].poses) == 5


def test_frames_come_back_in_order_with_the_simulated_time(recorded: tuple[Path, list]):
    frames = list(read_frames(recorded[0] / "rule-based-seed-2.mcap"))
    assert [frame.step for frame in frames] == list(range(1, len(frames) + 1))
    np.testing.assert_allclose(np.diff([frame.time for frame in frames]), 0.4, atol=1e-9)
    assert all(frame.episode_seed == 2 and frame.driver == "rule-based" for frame in frames)


def test_a_file_that_was_cut_off_gives_what_is_whole(recorded: tuple[Path, list], tmp_path: Path):
    content = (recorded[0] / "rule-based-seed-1.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: len(content) - 200])
    assert len(list(read_frames(cut))) > 0


def test_a_file_that_is_no_recording_is_named(tmp_path: Path):
    file = tmp_path / "text.mcap"
    file.write_text("no recording")
    with pytest.raises(InvalidRecording, match=r"text\.mcap is not a recorded episode"):
        list(read_frames(file))


@pytest.mark.parametrize("size", [0, 5, 8, 50, 100, 500])
def test_a_file_cut_off_before_its_first_frame_says_so(
    recorded: tuple[Path, list], tmp_path: Path, size: int
):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((recorded[0] / "rule-based-seed-1.mcap").read_bytes()[:size])
    with pytest.raises(InvalidRecording, match="it is cut short before the first frame, damaged, or no MCAP"):
        list(read_frames(cut))


def test_a_recording_that_cannot_be_read_is_named(tmp_path: Path):
    with pytest.raises(
        InvalidRecording, match=r"is not a recorded episode: it is a folder, should be a file$"
    ):
        list(read_frames(tmp_path))

    with pytest.raises(
        InvalidRecording, match=r"gone\.mcap is not a recorded episode: it cannot be read: no such"
    ):
        list(read_frames(tmp_path / "gone.mcap"))
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(InvalidRecording, match="it is a pipe, socket or device, should be a file"):
        list(read_frames(tmp_path / "pipe.mcap"))


def test_an_episode_that_is_given_up_leaves_no_file(tmp_path: Path):
    recording = EpisodeRecording(tmp_path / "a.mcap")
    recording.write(Frame(image_width=0, image_height=0))
    assert os.listdir(tmp_path) == ["a.mcap.part"]
    recording.abandon()
    assert os.listdir(tmp_path) == []


def refused(*_: object, **__: object) -> None:
    """What a disk does that has had errors."""
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


def test_a_recording_that_cannot_be_begun_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Writer, "add_metadata", refused)
    with pytest.raises(EvaluatorError, match=r"^cannot write .*a\.mcap: read-only file system$"):
        EpisodeRecording(tmp_path / "a.mcap", Origin(1, {"town": "town02"}, "", "", "", "", ""))
    assert os.listdir(tmp_path) == []


def test_recordings_that_cannot_be_removed_end_no_evaluation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    told: list[str] = []
    driver = ReferenceDriver("blind", 1)
    recorder = Recorder(driver, tmp_path, episodes=1, kept=1, warn=told.append)
    older = tmp_path / "older.mcap"
    older.touch()
    os.utime(older, ns=(0, 0))
    for number in range(2):
        recorder._open[number] = EpisodeRecording(tmp_path / f"{number}.mcap")
    monkeypatch.setattr(Path, "unlink", refused)
    recorder.on_end(0, None)
    assert told == [f"cannot remove {older}: read-only file system; this evaluation is not recorded any more"]


def test_the_oldest_recordings_are_removed(tmp_path: Path):
    for number in range(6):
        file = tmp_path / f"{number}.mcap"
        file.write_bytes(b"")
        os.utime(file, ns=(number, 100 - number))
    prune_recordings(tmp_path, 2)
    assert sorted(os.listdir(tmp_path)) == ["0.mcap", "1.mcap"]


def test_a_recording_that_vanishes_while_the_folder_is_read_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    for number in range(4):
        (tmp_path / f"{number}.mcap").touch()
        os.utime(tmp_path / f"{number}.mcap", ns=(number, number))
    listed = list(tmp_path.glob("*.mcap"))
    (tmp_path / "3.mcap").unlink()
    monkeypatch.setattr(Path, "glob", lambda *_: iter(listed))
    links = links_value(tmp_path).tensor.string_val[0].decode()
    assert "2.mcap" in links
    assert "3.mcap" not in links
    prune_recordings(tmp_path, 2)
    assert sorted(os.listdir(tmp_path)) == ["1.mcap", "2.mcap"]


def test_a_recording_is_drawn_by_rerun_with_the_whole_scene(recorded: tuple[Path, list], tmp_path: Path):
    file = tmp_path / "episode.rrd"
    stream = rr.RecordingStream(APPLICATION)
    stream.save(file, default_blueprint=make_blueprint())
    drawing = SceneDrawing(stream)
    for frame in read_frames(recorded[0] / "rule-based-seed-1.mcap"):
        drawing.draw(frame)
    stream.flush()
    stream.disconnect()
    paths = entity_paths(file)
    for entity in (
        "/car/ego/body",
        "/car/vehicles/outline",
        "/car/route/line",
        "/car/waypoint/point",
        "/town/lanes",
        "/sees/birdeye",
        "/sees/lidar",
        "/speed/actual",
        "/speed/target",
        "/reward/collision",
        "/return/return",
        "/episode",
    ):
        assert entity in paths


def entity_paths(file: Path) -> str:
    program = Path(rerun_cli.__file__).with_name("rerun")
    subprocess.run([program, "rrd", "verify", file], check=True, timeout=60, capture_output=True)
    printed = subprocess.run(
        [program, "rrd", "print", file], check=True, timeout=60, capture_output=True, text=True
    )
    return printed.stdout
