"""Policies that come with the program are listed, found by name, and watched without a run."""

import json
from pathlib import Path
from typing import Any

import pytest
from athrl.errors import CommandError
from athrl.evaluate.drivers import find_driver
from athrl.policies import policies
from athrl.watch import watch
from athrl_evaluator.policies import shipped as shipped_policies

CARD: dict[str, Any] = {
    "planner": "athrl",
    "purpose": "Drives in town03.",
    "trained": "athrl train, 5 minutes on 2 cores",
    "commit": "0123456",
    "decisions": 400_000,
    "town": "town03",
    "scores": {"policy": {"return_mean": 3200.0, "return_ci95": 80.0, "collision_rate": 0.01}},
    "limits": ["100 vehicles"],
    "sha256": "",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(shipped_policies, "FOLDER", tmp_path)
    monkeypatch.chdir(tmp_path.parent)
    (tmp_path / "town03.json").write_text(json.dumps(CARD))
    (tmp_path / "town03.onnx").write_bytes(b"")
    return tmp_path


def test_policies_are_listed_with_their_cards(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    policies()
    said = capsys.readouterr().out
    for text in ("town03: Drives in town03.", "400,000", "return 3200 ± 80, collisions 1.0%", "100 vehicles"):
        assert text in said


def test_policies_are_listed_as_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    policies(as_json=True)
    assert json.loads(capsys.readouterr().out) == {"policies": {"town03": CARD}}


def test_installation_without_policies_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shipped_policies, "FOLDER", tmp_path / "none")
    policies()
    assert "no policies" in capsys.readouterr().out


def test_driver_is_a_reference_driver_a_file_or_a_policy_by_name(folder: Path) -> None:
    assert find_driver("blind") == "blind"
    assert find_driver("town03") == folder / "town03.onnx"
    mine = folder / "mine.onnx"
    mine.write_bytes(b"")
    assert find_driver(str(mine)) == mine


@pytest.mark.parametrize(
    ("policy", "told"),
    [
        (
            "town3",
            "--policy town3: there is no such file, and it is none of random, blind, rule-based, town03",
        ),
        ("town3", "; did you mean town03?"),
        ("rulebased", "; did you mean rule-based?"),
        ("gone.onnx", "--policy gone.onnx: there is no such file, and it is none of random"),
        ("some/where", "--policy some/where: there is no such file"),
        (".", "--policy .: is a folder"),
        ("/dev/null", "--policy /dev/null: is a pipe, socket or device, and it is none of"),
    ],
)
def test_driver_that_there_is_not_is_told_in_one_line(folder: Path, policy: str, told: str) -> None:
    with pytest.raises(CommandError) as caught:
        find_driver(policy)
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"town": "town02"}, "--town is for watching a policy without a run"),
        ({"force": ["intention=0"]}, "--force is for watching a policy without a run"),
        ({"save": Path("a.rrd")}, "--save is for watching a policy without a run"),
        ({"policy": "blind", "overwrite": True}, "--overwrite replaces the file of --save"),
        ({"policy": "blind", "what": "one"}, "one cannot be used with --policy"),
        ({"policy": "blind", "save": Path("a.rrd"), "serve": 9999}, "--serve cannot be used with --save"),
        ({"policy": "blind", "town": "town3"}, "--town town3: "),
        ({"policy": "town3"}, "did you mean town03?"),
    ],
)
def test_watching_refuses_what_it_would_ignore(folder: Path, options: dict[str, Any], told: str) -> None:
    with pytest.raises(CommandError) as caught:
        watch(**options)
    assert told in str(caught.value)


def test_episodes_of_a_driver_are_saved_as_a_rerun_file(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = folder / "seen.rrd"
    watch(policy="blind", town="town02", save=file, seed=3)
    assert b"car/ego/body" in file.read_bytes()
    assert capsys.readouterr().out == f"{file}: 1 episode of blind in town02\n"
    file.write_bytes(b"older")
    with pytest.raises(CommandError, match=r"seen\.rrd: exists already: .* or add --overwrite"):
        watch(policy="blind", town="town02", save=file)
    assert file.read_bytes() == b"older"
    watch(policy="blind", town="town02", save=file, overwrite=True)
    assert file.read_bytes() != b"older"
