"""`benchmarks.failures` drives any policy on any map, and says in one line what cannot be driven."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from athrl_driving.maps.town import _FOLDER as TOWNS
from athrl_evaluator.policies.shipped import shipped_policy
from athrl_protocol.run_file import read_run_file, saved_toml, with_whole_maps

from benchmarks import failures


def said(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *words: str) -> list[str]:
    """The lines that the benchmark prints."""
    monkeypatch.setattr("sys.argv", ["failures", *words])
    failures.main()
    return capsys.readouterr().out.splitlines()


def test_a_policy_is_named_as_for_the_command(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["towns", "--town", "town02", "--vehicles", "0", "--episodes", "2"]
    lines = said(capsys, monkeypatch, *words)
    assert lines[0] == "town02, 0 vehicles"
    assert json.loads(lines[-1])["episodes"] == 2


def test_a_policy_of_a_run_drives_as_in_its_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "policies").mkdir()
    policy = shutil.copy(shipped_policy("towns"), tmp_path / "policies" / "latest.onnx")
    shutil.copy(TOWNS / "town02.xodr", tmp_path / "m.xodr")
    settings = [f"environment.towns={tmp_path}/m.xodr", "environment.vehicles=3"]
    (tmp_path / "run.toml").write_text(saved_toml(with_whole_maps(read_run_file(None, settings))))
    lines = said(capsys, monkeypatch, str(policy), "--episodes", "2")
    assert lines[0] == f"{tmp_path}/m.xodr, 3 vehicles"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("towns --town town02 --vehicles 900", r"^environment\.vehicles is 900, town02 has room for \d+$"),
        ("towns --town town2", "^there is no town named 'town2'"),
        ("twons", "^twons: there is no such file, .*did you mean towns"),
        ("rule-based", "^rule-based: drives without a policy"),
    ],
)
def test_what_cannot_be_driven_is_one_line(
    words: str, told: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(SystemExit, match=told) as ended:
        said(capsys, monkeypatch, *words.split())
    assert "\n" not in str(ended.value)
