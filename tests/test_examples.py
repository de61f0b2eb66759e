"""Every program in `examples/` runs as it stands and prints what it is there to show."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
POLICY = EXAMPLES.parent / "services/evaluator/athrl_evaluator/policies/town03.onnx"


def run(program: str, *arguments: str, folder: Path) -> str:
    """Run an example in a folder of its own and return what it printed."""
    result = subprocess.run(
        [sys.executable, str(EXAMPLES / program), *arguments],
        cwd=folder, capture_output=True, text=True, timeout=240, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.parametrize(
    ("program", "shown"),
    [
        ("drive_an_environment.py", "driving score:"),
        ("train_with_stable_baselines3.py", "return of one episode:"),
        ("accelerate_highway_env.py", "the same observation: True"),
    ],
)
def test_example_shows_what_it_is_there_for(program: str, shown: str, tmp_path: Path) -> None:
    assert shown in run(program, folder=tmp_path)


def test_policy_is_deployed_with_onnx_runtime_alone(tmp_path: Path) -> None:
    assert "target_speed" in run("deploy_a_policy.py", str(POLICY), folder=tmp_path)
    assert "athrl_" not in (EXAMPLES / "deploy_a_policy.py").read_text()


def test_evaluated_episode_is_recorded_and_read_with_mcap_alone(tmp_path: Path) -> None:
    assert "rule-based" in run("evaluate_a_policy.py", str(tmp_path), folder=tmp_path)
    recording = sorted(tmp_path.glob("*.mcap"))[0]
    assert "mean speed" in run("read_a_recording.py", str(recording), folder=tmp_path)
    assert "athrl_" not in (EXAMPLES / "read_a_recording.py").read_text()


def test_every_example_is_in_the_list() -> None:
    page = (EXAMPLES / "README.md").read_text()
    for program in EXAMPLES.glob("*.py"):
        assert f"]({program.name})" in page
