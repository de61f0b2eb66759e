"""`athrl replay` says in a line and by its exit code whether an episode is the same."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from athrl_evaluator import EvaluationSettings, evaluate_driver
from athrl_evaluator.policies.shipped import shipped_policy
from athrl_evaluator.recording.reading import read_driven, read_frames
from athrl_evaluator.recording.recordings import EpisodeRecording
from athrl_protocol.run_file import EnvironmentSection


def replay(*arguments: object) -> tuple[int, str, str]:
    result = subprocess.run(
        [sys.executable, "-m", "athrl", "replay", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )
    return result.returncode, result.stdout, result.stderr


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    environment = EnvironmentSection(towns="town02", vehicles=5, episode_ticks=40)
    evaluate_driver("blind", EvaluationSettings(2, 7, environment), record=folder)
    return folder / "blind-seed-7.mcap"


def test_the_same_states_end_with_0(recording: Path) -> None:
    code, out, error = replay(recording)
    assert (code, error) == (0, "")
    assert out == f"{recording}: the same, bit for bit: 10 decisions (4.0 s) of blind in town02, seed 7\n"


def test_a_policy_is_told_by_its_name(tmp_path: Path) -> None:
    environment = EnvironmentSection(towns="town02", vehicles=0, episode_ticks=8)
    evaluate_driver(shipped_policy("towns"), EvaluationSettings(2, 7, environment), record=tmp_path)
    assert " of policy towns in town02, seed 7" in replay(tmp_path / "towns-seed-7.mcap")[1]


def test_a_name_that_would_steer_a_terminal_is_shown_in_one_line(recording: Path, tmp_path: Path) -> None:
    odd = tmp_path / "a\x1b[31m\nb.mcap"
    odd.write_bytes(recording.read_bytes())
    _, out, _ = replay(odd)
    assert out.startswith(f"{tmp_path}/a\\u001b[31m b.mcap: the same, bit for bit: ")


def test_a_verdict_that_cannot_be_written_is_not_told_as_a_difference(recording: Path) -> None:
    with open("/dev/full", "w") as full:
        result = subprocess.run(
            [sys.executable, "-m", "athrl", "replay", recording],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=200,
        )
    assert result.returncode not in (0, 1)
    assert "athrl: cannot write the verdict: no space left on device\n" in result.stderr


def test_other_states_end_with_1_and_tell_the_first(recording: Path, tmp_path: Path) -> None:
    changed = EpisodeRecording(tmp_path / "a.mcap", read_driven(recording).origin)
    for frame in read_frames(recording):
        changed.write(frame, np.array([0.0, 0.9], np.float32))
    changed.finish()
    code, out, _ = replay(tmp_path / "a.mcap")
    assert code == 1
    assert "different from decision 1 on (0.4 s): " in out
    code, out, _ = replay(tmp_path / "a.mcap", "--json")
    facts = json.loads(out)
    assert (code, facts["same"], facts["first"]["decision"]) == (1, False, 1)
    assert facts["largest"]["size"] > 0


def test_what_is_no_recording_ends_with_2_and_one_line(tmp_path: Path) -> None:
    code, out, error = replay(tmp_path / "gone.mcap")
    assert (code, out) == (2, "")
    assert error.count("\n") == 1
    assert "gone.mcap is not a recorded episode: it cannot be read" in error
